// SPDX-License-Identifier: BSD-3-Clause
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <set>
#include <thread>

#include <loopwise/registration/task.hpp>
#include <loopwise/replay/outcome_store.hpp>
#include <loopwise/replay/replay.hpp>

#include "testing_mission.hpp"

namespace loopwise::outcome_store_test {
namespace {

using testing::OracleRegistrar;
using testing::TemporaryFolder;
using testing::two_circles;

/// Counts its requests.
class CountingRegistrar final : public Registrar {
 public:
  explicit CountingRegistrar(const Mission& mission) : oracle_(mission.ground_truth) {}
  std::string_view name() const override { return "counting"; }
  RegistrationResult compute(const RegistrationTask& task) const override {
    ++computed;
    return oracle_.compute(task);
  }
  mutable std::atomic<std::size_t> computed{0};

 private:
  OracleRegistrar oracle_;
};

std::vector<RegistrationTask> tasks_of(const Mission& mission, std::size_t count) {
  std::vector<RegistrationTask> tasks;
  const std::vector<Key> keys = mission.graph.keys();
  for (std::size_t i = 0; tasks.size() < count; ++i) {
    LoopCandidate candidate;
    candidate.id = i;
    candidate.from = keys[20 + i % 50];
    candidate.to = keys[i / 50];
    if (candidate.from == candidate.to) continue;
    tasks.push_back(make_task(mission.graph, mission.robots, candidate, TaskOptions(), 1));
  }
  return tasks;
}

void require_equal(const RegistrationResult& a, const RegistrationResult& b) {
  REQUIRE(outcome_line(a) == outcome_line(b));
  REQUIRE(a.candidate.id == b.candidate.id);
  REQUIRE(a.candidate.time_s == b.candidate.time_s);
}

StoredRegistrar stored(const Mission& mission, const std::shared_ptr<const Registrar>& registrar,
                       const testing::fs::path& folder, const std::string& context = "options",
                       OutcomeStoreOptions options = {}) {
  return {registrar, std::make_shared<OutcomeStore>(folder, options), mission.scans->loader(), context};
}

std::vector<testing::fs::path> files_of(const testing::fs::path& folder) {
  std::vector<testing::fs::path> files;
  for (const auto& entry : testing::fs::directory_iterator(folder)) files.push_back(entry.path());
  std::sort(files.begin(), files.end());
  return files;
}

std::uintmax_t bytes_of(const testing::fs::path& folder) {
  std::uintmax_t bytes = 0;
  for (const auto& file : files_of(folder)) bytes += testing::fs::file_size(file);
  return bytes;
}

}  // namespace

TEST_CASE("outcome store: stored outcomes equal the computed ones to the bit", "[replay][outcomes]") {
  const Mission mission = two_circles();
  const auto registrar = std::make_shared<CountingRegistrar>(mission);
  const TemporaryFolder folder;
  const std::vector<RegistrationTask> tasks = tasks_of(mission, 300);
  std::vector<RegistrationResult> first;
  {
    const StoredRegistrar store = stored(mission, registrar, folder.path());
    for (const RegistrationTask& task : tasks) {
      first.push_back(store.compute(task));
      require_equal(first.back(), OracleRegistrar(mission.ground_truth).compute(task));
    }
    REQUIRE(registrar->computed == 300);
    for (std::size_t i = 0; i < tasks.size(); ++i) require_equal(store.compute(tasks[i]), first[i]);
    REQUIRE(registrar->computed == 300);  // within a process too
  }
  const StoredRegistrar again = stored(mission, registrar, folder.path());
  for (std::size_t i = 0; i < tasks.size(); ++i) {
    RegistrationTask task = tasks[i];
    task.candidate.id += 7;  // another run numbers its candidates in its own way
    const RegistrationResult result = again.compute(task);
    REQUIRE(result.candidate.id == tasks[i].candidate.id + 7);
    REQUIRE(outcome_line(result) == outcome_line(first[i]));
  }
  REQUIRE(registrar->computed == 300);
}

TEST_CASE("outcome store: figures, messages and times of every kind survive", "[replay][outcomes]") {
  const Mission mission = two_circles();
  const TemporaryFolder folder;
  class Odd final : public Registrar {
   public:
    std::string_view name() const override { return "odd"; }
    RegistrationResult compute(const RegistrationTask& task) const override {
      RegistrationResult result;
      result.candidate = task.candidate;
      // All except those that are not stored, see depends_on_circumstances().
      constexpr auto kFirst = static_cast<std::uint64_t>(RejectionReason::kTooFewPoints);
      constexpr auto kCount = static_cast<std::uint64_t>(RejectionReason::kFailed) - kFirst;
      result.reason = static_cast<RejectionReason>(kFirst + task.candidate.id % kCount);
      result.message = std::string(task.candidate.id, '"') + std::string("\n\0 end", 6);
      if (task.candidate.id % 2 == 0) {
        result.T_from_to = Eigen::Isometry3d::Identity();
        result.T_from_to->translation() << 0.1, -0.0, 1.0 / 3.0;
      }
      result.overlap = 1e-300;
      result.features_s = 0.125;
      result.global_s = 1.0 / 3.0;
      result.refine_s = 1e-9;
      return result;
    }
  };
  const auto odd = std::make_shared<Odd>();
  const std::vector<RegistrationTask> tasks = tasks_of(mission, 40);
  for (int round = 0; round < 2; ++round) {
    const StoredRegistrar store = stored(mission, odd, folder.path());
    for (const RegistrationTask& task : tasks) {
      const RegistrationResult result = store.compute(task);
      require_equal(result, odd->compute(task));
      REQUIRE(result.message == odd->compute(task).message);
    }
  }
  REQUIRE(OutcomeStore(folder.path()).statistics().found_at_start == 40);
}

TEST_CASE("outcome store: the key contains all inputs of an outcome", "[replay][outcomes]") {
  const Mission mission = two_circles();
  const TemporaryFolder folder;
  const auto registrar = std::make_shared<CountingRegistrar>(mission);
  const StoredRegistrar store = stored(mission, registrar, folder.path());
  const RegistrationTask task = tasks_of(mission, 60).back();
  REQUIRE(task.target.size() > 2);
  const auto key = store.key_of(task);
  REQUIRE(key);
  REQUIRE(store.key_of(task) == key);

  const auto changed = [&](auto&& change) {
    RegistrationTask other = task;
    change(other);
    return store.key_of(other);
  };
  std::set<ContentHash> keys{*key};
  const auto require_new = [&](const std::optional<ContentHash>& other) {
    REQUIRE(other);
    REQUIRE(keys.insert(*other).second);
  };
  require_new(changed([](RegistrationTask& t) { ++t.seed; }));
  require_new(changed([](RegistrationTask& t) { ++t.enough_points; }));
  require_new(changed([](RegistrationTask& t) { t.guess_from_to.reset(); }));
  require_new(changed([](RegistrationTask& t) { t.guess_from_to->translation().x() += 1e-12; }));
  require_new(changed([](RegistrationTask& t) { t.guess_covariance = Matrix6d::Identity(); }));
  require_new(changed([](RegistrationTask& t) { t.guess_covariance = 2.0 * Matrix6d::Identity(); }));
  require_new(changed([](RegistrationTask& t) { t.target.pop_back(); }));
  require_new(changed([](RegistrationTask& t) { std::swap(t.target[0], t.target[1]); }));
  require_new(changed([](RegistrationTask& t) { t.target[1].T_center_member.translation().z() += 1e-12; }));
  require_new(changed([](RegistrationTask& t) { t.target[1].covariance(2, 2) += 1e-6; }));
  require_new(changed([](RegistrationTask& t) { t.source.push_back(t.target[2]); }));
  require_new(changed([](RegistrationTask& t) { std::swap(t.candidate.from, t.candidate.to); }));
  require_new(stored(mission, registrar, folder.path(), "other options").key_of(task));
  // Not: the number of the candidate, its source, when it came.
  REQUIRE(changed([](RegistrationTask& t) {
            t.candidate.id = 99;
            t.candidate.time_s = 3.0;
            t.candidate.distance_m = 4.0;
            t.candidate.source = CandidateSource::kRadio;
          }) == key);

  // Any point, normal or intensity of any scan of the two submaps.
  for (const Key scan : {task.source[0].key, task.target[0].key, task.target.back().key}) {
    for (int what = 0; what < 3; ++what) {
      const ScanLoader other = [&, scan, what](Key k) -> std::shared_ptr<const PointCloud> {
        auto cloud = std::make_shared<PointCloud>(*mission.scans->load(k));
        if (k != scan) return cloud;
        if (what == 0) cloud->points[7].y() += 1e-5F;
        if (what == 1) cloud->normals.assign(cloud->size(), Eigen::Vector3f::UnitZ());
        if (what == 2) cloud->intensities.assign(cloud->size(), 0.5F);
        return cloud;
      };
      require_new(StoredRegistrar(registrar, std::make_shared<OutcomeStore>(folder.path()), other, "options")
                      .key_of(task));
    }
  }

  // The context: kind, its options, the features'.
  RegistrationOptions options;
  const std::string context = registration_context(options);
  options.registrar = RegistrarKind::kPcl;
  REQUIRE(registration_context(options) != context);
  options = {};
  options.fast.fine_reach_m *= 1.0 + 1e-12;
  REQUIRE(registration_context(options) != context);
  options = {};
  options.features.voxel_m *= 2.0;
  REQUIRE(registration_context(options) != context);
  options = {};
  options.features.max_cache_mb *= 2.0;
  REQUIRE(registration_context(options) == context);
}

TEST_CASE("outcome store: damaged records are skipped, never used", "[replay][outcomes][error]") {
  const Mission mission = two_circles();
  const auto registrar = std::make_shared<CountingRegistrar>(mission);
  const TemporaryFolder folder;
  const std::vector<RegistrationTask> tasks = tasks_of(mission, 100);
  std::vector<RegistrationResult> first;
  {
    const StoredRegistrar store = stored(mission, registrar, folder.path());
    for (const RegistrationTask& task : tasks) first.push_back(store.compute(task));
  }
  REQUIRE(files_of(folder.path()).size() == 1);
  const testing::fs::path file = files_of(folder.path())[0];
  const std::string whole = testing::read_text(file);
  const auto computed_with = [&](const std::string& contents) {
    testing::write_text(file, contents);
    registrar->computed = 0;
    const StoredRegistrar store = stored(mission, registrar, folder.path());
    for (std::size_t i = 0; i < tasks.size(); ++i) require_equal(store.compute(tasks[i]), first[i]);
    return registrar->computed.load();
  };
  REQUIRE(computed_with(whole) == 0);
  REQUIRE(computed_with("") == 100);
  REQUIRE(computed_with("no outcome at all") == 100);
  REQUIRE(computed_with(whole.substr(0, whole.size() - 1)) == 1);
  REQUIRE(computed_with(whole.substr(5)) == 1);
  REQUIRE(computed_with("garbage" + whole) == 0);
  // A cut-off record in the middle, as a kill leaves it, followed by more.
  REQUIRE(computed_with(whole.substr(0, 1000) + whole) == 0);
  const auto damaged = [&](const std::string& contents) {
    testing::write_text(file, contents);
    return OutcomeStore(folder.path()).statistics().damaged_bytes;
  };
  REQUIRE(damaged(whole) == 0);
  REQUIRE(damaged("no outcome at all") == 17);
  REQUIRE(damaged("garbage" + whole) == 7);
  REQUIRE(damaged(whole + "garbage") == 7);
  const std::size_t cut_short = damaged(whole.substr(0, 1000) + whole);
  REQUIRE(cut_short > 0);
  REQUIRE(cut_short < 1000);
  // The last record is being written, from its first byte to its last but one.
  for (std::size_t end = whole.size() - 1; end > whole.size() - 100; --end) {
    CAPTURE(end);
    REQUIRE(damaged(whole.substr(0, end)) == 0);
  }
  std::string changed_before = whole.substr(0, whole.size() - 1);
  changed_before[40] = static_cast<char>(changed_before[40] ^ 1);  // in the first record
  REQUIRE(damaged(changed_before) > 0);
  testing::write_text(file, whole);
  Rng rng(3);
  for (int trial = 0; trial < 60; ++trial) {
    std::string changed = whole;
    const std::size_t at = rng.below(changed.size());
    changed[at] = static_cast<char>(changed[at] ^ (1 << rng.below(8)));
    CAPTURE(at);
    REQUIRE(computed_with(changed) == 1);  // the one that was hit
    const std::size_t cut = rng.below(whole.size());
    REQUIRE(computed_with(whole.substr(0, cut)) <= 100);
  }

  // Changed or deleted under an open store.
  testing::write_text(file, whole);
  registrar->computed = 0;
  const StoredRegistrar open = stored(mission, registrar, folder.path());
  {
    std::fstream out(file, std::ios::in | std::ios::out | std::ios::binary);
    out.seekp(static_cast<std::streamoff>(whole.size() / 2));
    out << "XXXXXXXX";
  }
  for (std::size_t i = 0; i < tasks.size(); ++i) require_equal(open.compute(tasks[i]), first[i]);
  REQUIRE(registrar->computed <= 2);
  REQUIRE(registrar->computed >= 1);
  testing::fs::remove_all(folder.path());
  for (std::size_t i = 0; i < tasks.size(); ++i) require_equal(open.compute(tasks[i]), first[i]);
  const std::vector<RegistrationTask> more = tasks_of(mission, 120);
  for (const RegistrationTask& task : more)
    require_equal(open.compute(task), OracleRegistrar(mission.ground_truth).compute(task));
  testing::fs::create_directories(folder.path());
}

TEST_CASE("outcome store: the size on disk is bounded, the oldest go first", "[replay][outcomes]") {
  const Mission mission = two_circles();
  const auto registrar = std::make_shared<CountingRegistrar>(mission);
  const TemporaryFolder folder;
  OutcomeStoreOptions options;
  options.max_mb = 1.0;
  std::vector<RegistrationTask> tasks = tasks_of(mission, 500);
  const std::size_t n = tasks.size();
  for (std::uint64_t seed = 2; seed < 12; ++seed) {  // 5500 outcomes of half a kilobyte
    for (std::size_t i = 0; i < n; ++i) {
      tasks.push_back(tasks[i]);
      tasks.back().seed = pair_seed(seed, tasks[i].candidate.from, tasks[i].candidate.to);
    }
  }
  {
    const StoredRegistrar store = stored(mission, registrar, folder.path(), "options", options);
    for (std::size_t i = 0; i < tasks.size(); ++i) {
      static_cast<void>(store.compute(tasks[i]));
      if (i % 100 == 0) REQUIRE(bytes_of(folder.path()) <= 1000000);
    }
  }
  REQUIRE(bytes_of(folder.path()) <= 1000000);
  REQUIRE(bytes_of(folder.path()) > 800000);
  registrar->computed = 0;
  const StoredRegistrar store = stored(mission, registrar, folder.path(), "options", options);
  static_cast<void>(store.compute(tasks.back()));
  REQUIRE(registrar->computed == 0);
  static_cast<void>(store.compute(tasks.front()));
  REQUIRE(registrar->computed == 1);
  options.max_mb = 0.5;
  REQUIRE_THROWS_AS(OutcomeStore(folder.path(), options), OptionError);
  testing::write_text(folder / "file", "");
  REQUIRE_THROWS_AS(OutcomeStore(folder / "file"), IoError);
}

TEST_CASE("outcome store: threads that ask for one outcome have it computed once",
          "[replay][outcomes][threads]") {
  const Mission mission = two_circles();
  const auto registrar = std::make_shared<CountingRegistrar>(mission);
  const TemporaryFolder folder;
  const StoredRegistrar store = stored(mission, registrar, folder.path());
  const std::vector<RegistrationTask> tasks = tasks_of(mission, 200);
  std::vector<std::thread> threads;
  for (int t = 0; t < 4; ++t) {
    threads.emplace_back([&] {
      for (const RegistrationTask& task : tasks) static_cast<void>(store.compute(task));
    });
  }
  for (std::thread& thread : threads) thread.join();
  REQUIRE(registrar->computed == 200);
  for (const RegistrationTask& task : tasks) {
    require_equal(store.compute(task), OracleRegistrar(mission.ground_truth).compute(task));
  }
}

TEST_CASE("outcome store: processes share a folder, and a killed one damages nothing", "[replay][outcomes]") {
  const Mission mission = two_circles();
  const TemporaryFolder folder;
  const std::vector<RegistrationTask> tasks = tasks_of(mission, 400);
  std::vector<pid_t> processes;
  for (std::size_t p = 0; p < 3; ++p) {
    const pid_t process = fork();
    if (process == 0) {
      {
        const StoredRegistrar store =
            stored(mission, std::make_shared<OracleRegistrar>(mission.ground_truth), folder.path());
        for (std::size_t i = 100 * p; i < 100 * p + 200; ++i) {
          static_cast<void>(store.compute(tasks[i]));
          if (p == 2 && i == 350) _exit(7);  // as a kill: nothing is closed
        }
      }
      _exit(0);
    }
    processes.push_back(process);
  }
  for (std::size_t p = 0; p < processes.size(); ++p) {
    int status = 0;
    REQUIRE(waitpid(processes[p], &status, 0) == processes[p]);
    REQUIRE(WIFEXITED(status));
    REQUIRE(WEXITSTATUS(status) == (p == 2 ? 7 : 0));
  }
  const auto registrar = std::make_shared<CountingRegistrar>(mission);
  const auto open = std::make_shared<OutcomeStore>(folder.path());
  REQUIRE(open->statistics().damaged_bytes == 0);
  const StoredRegistrar store(registrar, open, mission.scans->loader(), "options");
  for (const RegistrationTask& task : tasks) {
    require_equal(store.compute(task), OracleRegistrar(mission.ground_truth).compute(task));
  }
  REQUIRE(registrar->computed == 400 - 351);
  REQUIRE(open->statistics().hits == 351);
}

TEST_CASE("outcome store: outcomes without a neighbour's scan are not stored", "[replay][outcomes]") {
  struct Incomplete final : Registrar {
    explicit Incomplete(const Mission& mission) : oracle(mission.ground_truth) {}
    std::string_view name() const override { return "incomplete"; }
    RegistrationResult compute(const RegistrationTask& task) const override {
      RegistrationResult result = oracle.compute(task);
      result.incomplete = true;
      return result;
    }
    OracleRegistrar oracle;
  };
  const Mission mission = two_circles();
  const TemporaryFolder folder;
  {
    const StoredRegistrar store = stored(mission, std::make_shared<Incomplete>(mission), folder.path());
    for (const RegistrationTask& task : tasks_of(mission, 5)) REQUIRE(store.compute(task).incomplete);
  }
  REQUIRE(OutcomeStore(folder.path()).statistics().found_at_start == 0);
}

TEST_CASE("outcome store: concurrent writers leave at most one file each", "[replay][outcomes]") {
  const Mission mission = two_circles();
  const TemporaryFolder folder;
  const auto oracle = std::make_shared<OracleRegistrar>(mission.ground_truth);
  const std::vector<RegistrationTask> tasks = tasks_of(mission, 60);
  std::size_t next = 0;
  for (int time = 0; time < 10; ++time) {
    const StoredRegistrar one = stored(mission, oracle, folder.path());
    const StoredRegistrar two = stored(mission, oracle, folder.path());
    const StoredRegistrar three = stored(mission, oracle, folder.path());
    for (const StoredRegistrar* store : {&one, &two, &three}) {
      static_cast<void>(store->compute(tasks[next++]));
      static_cast<void>(store->compute(tasks[next++]));
    }
    REQUIRE(files_of(folder.path()).size() == 3);
  }
  REQUIRE(OutcomeStore(folder.path()).statistics().found_at_start == 60);
}

TEST_CASE("outcome store: failed registrations are not stored", "[replay][outcomes][error]") {
  const Mission mission = two_circles();
  const TemporaryFolder folder;
  const std::vector<RegistrationTask> tasks = tasks_of(mission, 3);
  const auto registrar = std::make_shared<CountingRegistrar>(mission);
  const auto open = std::make_shared<OutcomeStore>(folder.path());
  const Key broken = tasks[1].candidate.from;
  const StoredRegistrar store(
      registrar, open,
      [&](Key key) -> std::shared_ptr<const PointCloud> {
        if (key == broken) throw InputError("cut short");
        return key == tasks[2].candidate.from ? nullptr : mission.scans->load(key);
      },
      "options");
  for (int round = 0; round < 2; ++round) {
    for (const RegistrationTask& task : tasks) static_cast<void>(store.compute(task));
  }
  REQUIRE(registrar->computed == 1 + 2 + 2);

  class Throwing final : public Registrar {
   public:
    std::string_view name() const override { return "throwing"; }
    RegistrationResult compute(const RegistrationTask&) const override { throw std::runtime_error("no"); }
  };
  const StoredRegistrar throwing(std::make_shared<Throwing>(), open, mission.scans->loader(), "throwing");
  for (int round = 0; round < 2; ++round) REQUIRE_THROWS_WITH(throwing.compute(tasks[0]), "no");
  REQUIRE_THROWS_AS(StoredRegistrar(nullptr, open, mission.scans->loader(), ""), InputError);
}

TEST_CASE("outcome store: outcomes that failed because of a file, memory or time are computed again",
          "[replay][outcomes][error]") {
  const Mission mission = two_circles();
  const TemporaryFolder folder;
  const std::vector<RegistrationTask> tasks = tasks_of(mission, 1);
  class FailingRegistrar final : public Registrar {
   public:
    std::string_view name() const override { return "failing"; }
    RegistrationResult compute(const RegistrationTask& task) const override {
      RegistrationResult result;
      result.candidate = task.candidate;
      result.reason = reasons.at(calls++);
      return result;
    }
    std::vector<RejectionReason> reasons{RejectionReason::kMissingScan, RejectionReason::kFailed,
                                         RejectionReason::kTimeLimit, RejectionReason::kLowOverlap};
    mutable std::size_t calls = 0;
  };
  const auto failing = std::make_shared<FailingRegistrar>();
  for (int run = 0; run < 6; ++run) {
    const StoredRegistrar store = stored(mission, failing, folder.path());
    const RejectionReason expected = failing->reasons.at(std::min(run, 3));
    REQUIRE(store.compute(tasks[0]).reason == expected);
  }
  REQUIRE(failing->calls == 4);
}

TEST_CASE("outcome store: a replay is the same with it, without it, and again",
          "[replay][outcomes][replay]") {
  const Mission mission = two_circles();
  const TemporaryFolder folder;
  const auto registrar = std::make_shared<CountingRegistrar>(mission);
  ReplayOptions config;
  config.batch = 20;
  config.engine.guess = GuessSource::kOdometry;
  config.prioritization.observability.min_sum = 0.0;
  const auto lines = [&](const std::string& method, bool with_store, int threads) {
    config.prioritization.method = parse_method(method);
    const auto features =
        std::make_shared<FeatureCache>(mission.scans->loader(), config.registration.features);
    std::shared_ptr<const Registrar> used = registrar;
    if (with_store) {
      used = std::make_shared<StoredRegistrar>(registrar, std::make_shared<OutcomeStore>(folder.path()),
                                               mission.scans->loader(), "options");
    }
    std::vector<std::string> journal;
    ReplayHooks hooks;
    hooks.journal = [&](const std::string& line) { journal.push_back(line); };
    ThreadPool pool(threads);
    static_cast<void>(MissionReplay(mission, config, {features, used}).run(pool, hooks));
    return journal;
  };
  for (const char* method : {"random", "baseline", "full"}) {
    const auto without = lines(method, false, 1);
    REQUIRE(lines(method, true, 2) == without);
    registrar->computed = 0;
    REQUIRE(lines(method, true, 1) == without);
    REQUIRE(registrar->computed == 0);
  }
}

}  // namespace loopwise::outcome_store_test
