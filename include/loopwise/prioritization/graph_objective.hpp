// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <string_view>
#include <vector>

#include <Eigen/Core>

#include <loopwise/core/export.hpp>
#include <loopwise/core/loop_candidate.hpp>
#include <loopwise/core/pose_graph.hpp>

namespace loopwise {

/// Uncertainty of the graph with a set of hypothetical closures added: e(PG ∪ l) of the paper's eq. 1, which
/// selectors minimise over sets of a fixed list of candidates. The place in that list identifies a candidate.
/// An objective holds one current set; changes of it can be evaluated without changing it.
///
/// Not thread-safe: evaluation uses scratch memory.
class LOOPWISE_EXPORT GraphObjective {
 public:
  virtual ~GraphObjective() = default;

  /// Short and stable, for tables and logs.
  [[nodiscard]] virtual std::string_view name() const = 0;

  /// Number of candidates.
  [[nodiscard]] virtual std::size_t size() const = 0;

  /// The current set, empty at first, in the order of addition; a swap puts the new candidate in the place of
  /// the old one.
  [[nodiscard]] virtual const std::vector<std::size_t>& selected() const = 0;
  /// Whether a candidate is in the current set.
  [[nodiscard]] virtual bool contains(std::size_t candidate) const = 0;

  /// The objective of the current set; lower is better.
  [[nodiscard]] virtual double value() = 0;

  /// value() after the change minus value() now. \pre `candidate` and `in` are not in the set; `out` and a
  /// removed candidate are.
  [[nodiscard]] virtual double add_change(std::size_t candidate) = 0;
  /// See add_change().
  [[nodiscard]] virtual double remove_change(std::size_t candidate) = 0;
  /// See add_change().
  [[nodiscard]] virtual double swap_change(std::size_t out, std::size_t in) = 0;

  /// add_change() of every candidate, 0 for those in the set, for greedy choice. Implementations are faster
  /// than single calls, and may be accurate only to about 1e-6 of the change.
  [[nodiscard]] virtual std::vector<double> add_changes() = 0;

  /// Replaces the current set. \throws InputError on a repeated member or one that is not there.
  virtual void assign(const std::vector<std::size_t>& set) = 0;
  /// Adds a candidate to the set. \pre it is not in it.
  virtual void add(std::size_t candidate) = 0;
  /// Removes a candidate from the set. \pre it is in it.
  virtual void remove(std::size_t candidate) = 0;
  /// Puts `in` into the place of `out`. \pre `out` is in the set, `in` is not.
  virtual void swap(std::size_t out, std::size_t in) = 0;

  /// The candidate connects two parts of the graph of which one has no prior. Such a closure has no finite
  /// gain: the objective is computed for each part separately and does not count it.
  [[nodiscard]] virtual bool connecting(std::size_t candidate) const = 0;
};

/// Members of a set of candidates, in order, with their places, for implementations.
class LOOPWISE_EXPORT CandidateSet {
 public:
  /// The empty set of `size` candidates.
  explicit CandidateSet(std::size_t size) : place_(size, kAbsent) {}
  /// In order.
  [[nodiscard]] const std::vector<std::size_t>& members() const { return members_; }
  /// Whether a candidate is in the set.
  [[nodiscard]] bool contains(std::size_t candidate) const { return place_[candidate] != kAbsent; }
  /// Puts a candidate at the end. \pre it is not in the set.
  void add(std::size_t candidate) {
    place_[candidate] = members_.size();
    members_.push_back(candidate);
  }
  /// Removes a candidate; later ones move up.
  void remove(std::size_t candidate) {
    const std::size_t place = place_[candidate];
    members_.erase(members_.begin() + static_cast<std::ptrdiff_t>(place));
    place_[candidate] = kAbsent;
    for (std::size_t i = place; i < members_.size(); ++i) place_[members_[i]] = i;
  }
  /// Puts `in` into the place of `out`. \pre `out` is in the set, `in` is not.
  void swap(std::size_t out, std::size_t in) {
    members_[place_[out]] = in;
    place_[in] = place_[out];
    place_[out] = kAbsent;
  }
  /// \throws InputError on a repeated member or one that is not there.
  void assign(const std::vector<std::size_t>& members);
  /// Removes all candidates.
  void clear();

 private:
  static constexpr std::size_t kAbsent = static_cast<std::size_t>(-1);
  std::vector<std::size_t> members_;
  std::vector<std::size_t> place_;
};

/// Midpoints of the candidates' nodes at the graph's poses, one each: the positions of closures for the
/// spread of a set. \throws UnknownKeyError
[[nodiscard]] LOOPWISE_EXPORT std::vector<Eigen::Vector3d> candidate_midpoints(
    const PoseGraph& graph, const std::vector<LoopCandidate>& candidates);

}  // namespace loopwise
