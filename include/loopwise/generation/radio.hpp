// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <set>
#include <string>
#include <string_view>

#include <utility>
#include <vector>

#include <loopwise/core/export.hpp>
#include <loopwise/core/options.hpp>
#include <loopwise/core/problems.hpp>
#include <loopwise/core/radio.hpp>
#include <loopwise/core/robots.hpp>
#include <loopwise/generation/candidate_generator.hpp>

namespace loopwise {

/// When a node is near a beacon, and the extent of a fly-by.
struct RadioOptions {
  /// A node is near a beacon if its path loss, averaged over the receivers, is less than this, dB.
  double max_loss_db = 60.0;
  /// Near nodes of one robot belong to one fly-by if their indices differ by at most this.
  std::int64_t max_gap_nodes = 20;
  /// Maximum number of nodes whose readings wait until the node or the beacon is known. Beyond it, the oldest
  /// are dropped.
  std::int64_t max_waiting = 100000;

  template <class Self, class Visitor>
  static void visit(Self& self, Visitor&& field) {
    field("max_loss_db", self.max_loss_db, above(0.0));
    field("max_gap_nodes", self.max_gap_nodes, at_least(1));
    field("max_waiting", self.max_waiting, at_least(0));
  }
};

/// Mean path loss transmit − receive over the receivers with a reading, dB; NaN without readings.
[[nodiscard]] LOOPWISE_EXPORT double mean_path_loss_db(const std::vector<RadioReading>& readings);

/// Proposes pairs of nodes that passed the same radio beacon (paper §III-D). A node is *near* a beacon if its
/// mean path loss is positive and less than a threshold. The node where a robot drops the beacon is fly-by 0.
/// Near nodes of one robot with adjacent indices form one **fly-by**; fly-bys are numbered in the order in
/// which they begin, and robots that alternate at a beacon do not split each other's. The robot that drops a
/// beacon is near it until it leaves. Its first fly-by starts after that. Readings of other robots before the
/// drop are ignored.
///
/// Each node of a fly-by is paired with the nodes of all other known fly-bys of that beacon, in their order
/// and the order of traversal. Nodes, readings and drops may come in any order; readings wait for missing
/// nodes and beacons.
///
/// After std::bad_alloc the same input can be given again; only flaws may count twice.
class LOOPWISE_EXPORT RadioGenerator final : public CandidateGenerator {
 public:
  /// \throws OptionError
  RadioGenerator(const RadioOptions& options, Robots robots);

  [[nodiscard]] std::string_view name() const override { return "radio"; }

  /// A beacon was dropped. A known beacon does not change ("beacon dropped twice").
  [[nodiscard]] std::vector<LoopCandidate> on_drop(const PoseGraph& graph, const BeaconDrop& drop,
                                                   double time_s);

  /// All readings of some nodes: those of one node and beacon must come together. Repeated readings are
  /// ignored. Readings without a robot's node are counted ("radio reading at a node of no robot").
  [[nodiscard]] std::vector<LoopCandidate> on_radio(const PoseGraph& graph,
                                                    const std::vector<RadioReading>& readings, double time_s);

  /// Uses the readings that waited for the node.
  [[nodiscard]] std::vector<LoopCandidate> on_node(const PoseGraph& graph, Key key, double time_s) override;

  /// Number of nodes with readings that wait for their node or their beacon.
  [[nodiscard]] std::size_t waiting() const { return waiting_.size(); }
  /// Flaws of the readings so far.
  [[nodiscard]] const Problems& problems() const { return problems_; }

 private:
  struct FlyBy {
    std::size_t robot;
    std::uint64_t last_index;
    std::vector<Key> nodes;
  };
  struct Beacon {
    BeaconDrop drop;
    bool departing = true;  ///< The dropping robot has not left yet.
    std::uint64_t departed_index = 0;
    std::vector<FlyBy> fly_bys;                  ///< From 1; fly-by 0 is the drop's node.
    std::map<std::size_t, std::size_t> current;  ///< Robot -> its latest fly-by.
    std::set<Key> seen;
  };

  using Detection = std::pair<Key, std::string>;  ///< A node and the beacon that it is near to.
  /// Processes those detections whose node, beacon and drop are known now.
  void process_detections(const PoseGraph& graph, std::vector<Detection> detections, double time_s);
  [[nodiscard]] std::vector<Detection> waiting_at(const std::string& beacon) const;
  void drop_oldest();
  void process_detection(const PoseGraph& graph, Beacon& beacon, Key key, double time_s);

  RadioOptions options_;
  Robots robots_;
  std::map<std::string, Beacon> beacons_;
  std::map<Detection, std::size_t> waiting_;             ///< -> number of arrival.
  std::map<std::size_t, Detection> waiting_by_arrival_;  ///< The same.
  std::map<std::string, std::set<Key>> waiting_nodes_;   ///< The same, by beacon.
  std::size_t arrivals_ = 0;
  std::set<std::pair<Key, Key>> proposed_;
  std::vector<LoopCandidate> proposals_;  ///< Of detections since candidates were last returned.
  Problems problems_;
};

}  // namespace loopwise
