// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/engine/events.hpp>

#include <loopwise/core/error.hpp>
#include <loopwise/core/recognition.hpp>
#include <loopwise/core/se3.hpp>

#include "factor.hpp"

namespace loopwise {
namespace {

class Checker {
 public:
  explicit Checker(const Robots& robots) : robots_(robots) {}

  void operator()(const KeyFrame& frame) const {
    owned(frame.node.key);
    PoseGraph scratch;
    scratch.add_node(frame.node);
    factors(factors_of(frame));
  }
  void operator()(const Factors& f) const { factors(factors_of(f)); }
  void operator()(const event::Scan& event) const {
    owned(event.scan.key);
    if (!event.scan.cloud) {
      throw InputError("scan of node " + key_name(event.scan.key) + " is a null pointer");
    }
  }
  void operator()(const event::Radio& event) const {
    for (const RadioReading& reading : event.readings) owned(reading.key);
  }
  void operator()(const BeaconDrop& drop) const { owned(drop.drop_key); }
  void operator()(const event::Candidates& event) const {
    for (const LoopCandidate& candidate : event.candidates) {
      owned(candidate.from);
      owned(candidate.to);
      if (candidate.from == candidate.to)
        throw InputError("candidate from node " + key_name(candidate.from) + " to itself");
      if (candidate.recognition) check_recognition(candidate, *candidate.recognition);
    }
  }
  static void check_recognition(const LoopCandidate& candidate, const Recognition& recognition) {
    const std::string what = "candidate " + key_name(candidate.from) + " - " + key_name(candidate.to);
    if (recognition.similarity < 0.0 || recognition.similarity > 1.0)
      throw InputError(what + ": similarity " + std::to_string(recognition.similarity) + " is not in [0, 1]");
    if (!recognition.T_from_to) return;
    if (!recognition.T_from_to->matrix().allFinite() || !recognition.covariance.allFinite())
      throw InputError(what + ": the guessed pose or its covariance is not finite");
    if (se3::rotation_defect(recognition.T_from_to->linear()) > 1e-6)
      throw InputError(what + ": the guessed pose is not a rigid transform");
  }
  void operator()(const ExternalEstimate& estimate) const {
    for (const auto& [key, pose] : estimate.poses) {
      const std::string what = "estimate of node " + key_name(key);
      if (!pose.matrix().allFinite()) throw InputError(what + " is not finite");
      if (se3::rotation_defect(pose.linear()) > 1e-3) throw InputError(what + " is not a rigid transform");
    }
    for (const auto& [key, covariance] : estimate.covariances) {
      if (!covariance.allFinite()) throw InputError("covariance of node " + key_name(key) + " is not finite");
    }
  }
  template <class Other>
  void operator()(const Other& /*made by the engine's driver*/) const {}

 private:
  void owned(Key key) const { static_cast<void>(robots_.of(key)); }
  void factors(const std::vector<Factor>& all) const {
    for (const Factor& factor : all) {
      check_factor(factor);
      for (const Key key : keys_of(factor)) owned(key);
    }
  }

  const Robots& robots_;
};

}  // namespace

void check_event(const Event& event, const Robots& robots) {
  std::visit(Checker(robots), event);
}

}  // namespace loopwise
