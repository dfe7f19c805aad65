// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/replay/registration.hpp>

#include <utility>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/io/json_options.hpp>
#include <loopwise/replay/code_version.hpp>
#include <loopwise/replay/outcome_store.hpp>

namespace loopwise {
namespace {

std::shared_ptr<const Registrar> make_registrar(const RegistrationOptions& options,
                                                std::shared_ptr<FeatureCache> features) {
  if (options.registrar == RegistrarKind::kFast) {
    return std::make_shared<FastRegistrar>(std::move(features), options.fast);
  }
  if (options.registrar == RegistrarKind::kIcp) {
    return std::make_shared<IcpRegistrar>(std::move(features), options.icp);
  }
#ifdef LOOPWISE_WITH_PCL
  return std::make_shared<PclRegistrar>(std::move(features), options.pcl);
#else
  throw OptionError("registrar = \"pcl\": this build was made without PCL");
#endif
}

Json options_of(const RegistrationOptions& options) {
  switch (options.registrar) {
    case RegistrarKind::kFast:
      return to_json(options.fast);
    case RegistrarKind::kPcl:
      return to_json(options.pcl);
    case RegistrarKind::kIcp:
      return to_json(options.icp);
  }
  throw OptionError("registrar: unknown");
}

}  // namespace

Registration make_registration(const RegistrationOptions& options, const ScanLoader& scans,
                               std::shared_ptr<OutcomeStore> store) {
  Registration out;
  out.features = std::make_shared<FeatureCache>(scans, options.features);
  out.registrar = make_registrar(options, out.features);
  if (store) {
    out.registrar = std::make_shared<StoredRegistrar>(out.registrar, std::move(store), scans,
                                                      registration_context(options));
  }
  return out;
}

std::string registration_context(const RegistrationOptions& options) {
  Json json = Json::object();
  json["registrar"] = enum_name(options.registrar);
  json["features"] = to_json(options.features);
  json["features"].erase("max_cache_mb");
  json["options"] = options_of(options);
  json["code"] = registration_code_version();
  return json.dump();
}

}  // namespace loopwise
