// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Features and the registrar that uses them, made from one configuration.
#pragma once

#include <memory>
#include <string>

#include <loopwise/core/export.hpp>
#include <loopwise/core/keyed_scan.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/features/feature_cache.hpp>
#include <loopwise/registration/fast_registrar.hpp>
#include <loopwise/registration/icp_registrar.hpp>
#include <loopwise/registration/pcl_registrar.hpp>
#include <loopwise/registration/registrar.hpp>

namespace loopwise {

class OutcomeStore;

/// Implementation that computes the candidates.
enum class RegistrarKind {
  kFast,  ///< FastRegistrar
  kPcl,   ///< PclRegistrar, the reference
  kIcp,   ///< IcpRegistrar, the way of open SLAM programs
};
[[nodiscard]] inline EnumNames<RegistrarKind> enum_names(RegistrarKind) {
  return {{RegistrarKind::kFast, "fast"}, {RegistrarKind::kPcl, "pcl"}, {RegistrarKind::kIcp, "icp"}};
}

/// Preparation of scans and registration of pairs.
struct RegistrationOptions {
  /// Registration of candidates: fast, pcl (the reference) or icp (for comparison).
  RegistrarKind registrar = RegistrarKind::kFast;
  FeatureOptions features;    ///< Voxels, normals, cache.
  FastRegistrarOptions fast;  ///< Options of the registrar `fast`.
  PclRegistrarOptions pcl;    ///< Options of the registrar `pcl`, the reference.
  IcpRegistrarOptions icp;    ///< Options of the registrar `icp`.

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("registrar", self.registrar, any_value());
  }
};

/// A registrar with its features.
struct Registration {
  std::shared_ptr<FeatureCache> features;      ///< Features of scans; also for the observability score.
  std::shared_ptr<const Registrar> registrar;  ///< Uses these features. Thread-safe.
};

/// \param options of features and registrar
/// \param scans reads the scan of a node
/// \param store of outcomes, under a key of all their input; may be null
/// \throws OptionError, also if this build lacks the registrar
[[nodiscard]] LOOPWISE_EXPORT Registration make_registration(const RegistrationOptions& options,
                                                             const ScanLoader& scans,
                                                             std::shared_ptr<OutcomeStore> store = nullptr);

/// All input of a registration besides its task and scans, as a text: the registrar's kind and options, those
/// of the features, and the version of the code.
[[nodiscard]] LOOPWISE_EXPORT std::string registration_context(const RegistrationOptions& options);

}  // namespace loopwise
