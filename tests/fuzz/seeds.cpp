// SPDX-License-Identifier: BSD-3-Clause
#include "seeds.hpp"

#include <cstring>

#include <nlohmann/json.hpp>

#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/cloud.hpp>
#include <loopwise/io/csv.hpp>
#include <loopwise/io/g2o.hpp>
#include <loopwise/io/trajectory.hpp>

#include "lamp_data.hpp"
#include "lzf.hpp"
#include "mission_seeds.hpp"
#ifdef LOOPWISE_FUZZ_ROSBAG2
#include "rosbag2_seeds.hpp"
#endif
#include "target.hpp"

namespace loopwise::fuzz {
namespace {

namespace fs = std::filesystem;

PointCloud cloud(bool normals) {
  PointCloud out;
  for (int i = 0; i < 4; ++i) {
    out.points.emplace_back(static_cast<float>(i) - 1.5f, 2.0f, 0.25f * static_cast<float>(i));
    out.intensities.push_back(static_cast<float>(10 * i));
    if (normals) out.normals.emplace_back(0.0f, -1.0f, 0.0f);
  }
  return out;
}

std::string sized(std::size_t choice, std::size_t size, const std::string& bytes) {
  std::string out(1, static_cast<char>(choice));
  for (const int shift : {16, 8, 0}) out += static_cast<char>(size >> shift & 255);
  return out + bytes;
}

}  // namespace

Seeds io_seeds() {
  Seeds all;
  const fs::path missions = scratch() / "seed_missions", runs = scratch() / "seed_runs";
  write_seed_missions(missions);
  write_seed_runs(runs);
  const auto file = [](const fs::path& path) { return read_file(path); };

  all["g2o"] = {{"graph", file(missions / "g2o_pcd" / "result.g2o")},
                {"planar",
                 "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0.5 -2.25\nEDGE_PRIOR_SE2 0 0 0 0 9 0 0 9 0 9\nFIX 0\n"
                 "EDGE_SE2 0 1 1 0.5 -2.25 10 1 2 20 3 30\nEDGE_SE2 1 1 0 0 0 1 0 0 1 0 1\n"
                 "EDGE_SE2 1 0 -1 0 3.1 1 1.000001 0 1 0 1\nEDGE_SE2 1 0 -1 0 3.1\nVERTEX_XY 5 1 2\n"},
                {"tags",
                 "# comment\nVERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 1 1 0 0 0 0 0 2\r\nFIX 0 1\n"
                 "PARAMS_SE3OFFSET 3 0 0 1 0 0 0 1\nEDGE_SE3_PRIOR 1 3 1 0 0 0 0 0 1"
                 " 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1\nOTHER 1\n"}};
  for (const bool normals : {false, true}) {
    const std::string name = normals ? "normals" : "plain";
    const fs::path path = scratch() / "seed.pcd";
    for (const auto& [encoding, word] : enum_names(PcdEncoding{})) {
      write_pcd(path, cloud(normals), encoding);
      all["cloud_pcd"].push_back({name + "_" + std::string(word), file(path)});
    }
    write_ply(path, cloud(normals));
    all["cloud_ply"].push_back({name, file(path)});
  }
  all["cloud_ply"].push_back(
      {"ascii",
       "ply\nformat ascii 1.0\ncomment no\nelement vertex 2\nproperty double x\nproperty float y\n"
       "property short z\nproperty uchar intensity\nelement face 0\n"
       "property list uchar int vertex_indices\nend_header\n1 2 3 4\nnan 1 2 3\n"});
  all["cloud_bin"] = {
      {"two", std::string("\0\0\x80\x3f\0\0\0\x40\0\0\0\0\0\0\0\x3f", 16) + std::string(16, '\0')},
      {"empty", ""}};
  all["lzf"] = {{"text", std::string("\0\x0c", 2) + lzf_compress("abcabcabcabc")},
                {"run", std::string("\x03\xe8", 2) + lzf_compress(std::string(1000, 'x'))}};
  all["json"] = {{"mission", file(missions / "mission" / "mission.json")},
                 {"all", R"({"a": [1, -2.5e3, true, null, "é\n"], "b": {"c": 1e-9}} // end)"}};
  CsvText two({"a", "b"});
  two.row("plain", 1.5).row("with \"quotes\", and\nlines", -3);
  all["csv"] = {{"two", with_choice(1, two.text())},
                {"one", with_choice(0, CsvText({"a"}).row("").row(7).text())}};
  const std::string kitti = file(missions / "session" / "odom_poses.txt"),
                    tum = file(runs / "run" / "trajectories" / "husky.tum");
  all["trajectory"] = {{"kitti", with_choice(0, kitti)},
                       {"tum", with_choice(0, tum)},
                       {"g2o", with_choice(0, file(missions / "g2o_pcd" / "result.g2o"))},
                       {"as_tum", with_choice(1, tum)},
                       {"as_kitti", with_choice(2, kitti)},
                       {"pair", with_choice(4, tum + std::string(1, '\0') + tum)},
                       {"far_stamps", with_choice(4, "-9.2e9 0 0 0 0 0 0 1\n" + std::string(1, '\0') +
                                                         "9.2e9 0 0 0 0 0 0 1\n")},
                       {"matrix", with_choice(5, "1 0 0 1\n0 1 0 2\n0 0 1 3\n0 0 0 1\n")},
                       {"seven", with_choice(5, "1 2 3 0 0 0 1\n")}};
  all["numbers"] = {{"numbers", "1 -2.5 1e300 1e-320 0.000001 +3 nan inf 18446744073709551615 a12 1.6e9\n"},
                    {"stamps", "1600000000.123456789 -0.5 1.6000000001e9 5e-9 9.2e9\n"}};
  all["candidates"] = {{"poses",
                        "from,to,score,x,y,z,qx,qy,qz,qw\na412,b17,0.83,1.5,-0.2,0.1,0,0,0.6,0.8\n"
                        "a413,b17,,,,,,,,\n7,9,1,,,,,,,\n"},
                       {"order", "score,to,from\n0.5,3,4\n"},
                       {"pairs", "from,to\n1,2\n"}};
  all["keys_csv"] = {{"keys",
                      "pc_0.pcd/pc_1.pcd/a3.pcd/7.ply\n6989586621679009792,pc_0.pcd,1600000000000000000\n"
                      "6989586621679009793,,1600000002000000000\n"}};
  all["key_frame"] = {{"data",
                       "stamp 1567410201 250000000\nestimate\n1 0 0 2\n0 1 0 3\n0 0 1 4\n0 0 0 1\nodom\n"
                       "1 0 0 2\n0 1 0 3\n0 0 1 4\n0 0 0 1\naccum_distance 2.5\nutm_coord 1 2 3\nid 12\n"}};
  const std::vector<double> numbers = {1.0, 2.0, 3.0, 4.0};
  std::vector<std::uint8_t> raw(32);
  std::memcpy(raw.data(), numbers.data(), raw.size());
  const nlohmann::json packed = {
      {"format", "loopwise-fuzz"},  {"version", 1}, {"a", nlohmann::json::binary(raw)},
      {"b", {1, 2, {{"c", true}}}}, {"d", -0.5},    {"e", "text"}};
  std::string cbor;
  nlohmann::json::to_cbor(packed, cbor);
  all["packed"] = {{"file", "\x02\x02" + cbor}};

  const SeedFiles& mission_files = seed_mission_files();
  for (std::size_t i = 0; i < mission_files.size(); ++i) {
    const auto& [folder, name] = mission_files[i];
    all["mission"].push_back(
        {folder + "_" + fs::path(name).filename().string(), with_choice(i, file(missions / folder / name))});
  }
  const SeedFiles& run_files = seed_run_files();
  for (std::size_t i = 0; i < run_files.size(); ++i) {
    const auto& [folder, name] = run_files[i];
    all["report"].push_back(
        {folder + "_" + fs::path(name).filename().string(), with_choice(i, file(runs / folder / name))});
  }

  all["run_journal"] = {
      {"run", file(runs / "run" / "journal.jsonl")},
      {"end", R"({"event":"end","time_s":3,"account":{"generated":4,"pruned":1,"computed":2}})"}};

  const std::vector<TypedMessage> messages = lamp_messages();
  std::string every;
  for (const TypedMessage& message : messages) {
    every += static_cast<char>(message.type);
    every += static_cast<char>(message.bytes.size() >> 8 & 255);
    every += static_cast<char>(message.bytes.size() & 255);
    every += message.bytes;
    all["ros_message"].push_back(
        {"type" + std::to_string(message.type) + "_" + std::to_string(all["ros_message"].size()),
         message_types()[message.type].definition + std::string(1, '\0') + message.bytes});
  }
  all["ros_message"].push_back({"small", "uint8[] a\nB[2] b\nstring[] c\n===\nMSG: B\nfloat32 x\ntime t\n" +
                                             std::string(1, '\0') + std::string("\2\0\0\0ab", 6) +
                                             std::string(24, '\1') + std::string("\1\0\0\0\1\0\0\0z", 9)});
  const std::string none(1, '\0');
  const std::string little = none + "\1" + none + none;
  all["cdr"] = {
      {"numbers", "uint8 a\nfloat64 b\nuint16[<=3] c\nstring d\n" + none + little + "\7" +
                      std::string(7, '\0') + "12345678" + "\1" + std::string(3, '\0') + "\1" +
                      std::string(3, '\0') + "\2" + std::string(3, '\0') + "h" + none},
      {"messages",
       "std_msgs/msg/Header header\nB[2] b\n===\nMSG: B\nbool x true\n===\nMSG: std_msgs/msg/Header\n"
       "builtin_interfaces/msg/Time stamp\nstring frame_id\n" +
           none + std::string(4, '\0') + std::string(8, '\1') + std::string(3, '\0') + "\1" + none + "\1\1"}};
  all["lamp"] = {{"all", with_choice(0, every)}, {"all_robots", with_choice(1, every)}};
  all["point_cloud2"] = {{"scan", with_choice(0, messages[1].bytes)}};
  all["bag_chunk"] = {{"none", sized(0, 5, "bytes")}};
  all["bag"] = {{"none", bag(messages)}};
#ifdef LOOPWISE_FUZZ_ROSBAG
  const std::string text = "a text that is repeated: a text that is repeated";
  all["bag_chunk"].push_back({"bz2", sized(1, text.size(), compressed("bz2", text))});
  all["bag_chunk"].push_back({"lz4", sized(2, text.size(), compressed("lz4", text))});
  for (const std::string how : {"bz2", "lz4"}) all["bag"].push_back({how, bag(messages, {how})});
#endif
#ifdef LOOPWISE_FUZZ_ROSBAG2
  for (const std::string how : {"none", "", "zstd", "lz4"})
    all["rosbag2"].push_back({"mcap_" + how, mcap(messages, how)});
  all["rosbag2"].push_back({"db3", db3(messages)});
  all["rosbag2"].push_back({"rtabmap", rtabmap_database()});
  // Blocks of zlib: stored, of the fixed code, of a code of its own.
  all["inflate"] = {
      {"stored", std::string("\x78\x01\x01\x05\0\xfa\xffhello\x06\x2c\x02\x15", 16)},
      {"fixed", std::string("\x78\x9c\xcb\x48\xcd\xc9\xc9\x07\0\x06\x2c\x02\x15", 13)},
      {"dynamic",
       std::string(
           "\x78\xda\x45\x4f\x81\x0d\xc0\x30\x08\x7a\xc5\xd7\x00\xff\xbf\x61\xc0\xda\xad\x69\x8d\x82\x0a\x05"
           "\x38\x80\x2f\x66\xe8\x98\x97\x30\x14\xb7\x95\x39\xb9\xa0\x70\xf9\xd0\xe3\x28\xa7\x52\x80\x6f\xd2"
           "\xad\xad\xe9\xb7\x4e\x3d\xa4\xd0\x86\x5d\x19\x62\xb5\x88\x64\x69\xfa\x67\xdf\x7d\x66\x4a\xe3\xf8"
           "\x48\x97\xd2\xae\x48\x45\x6c\x1c\x32\x7d\x05\xeb\xb0\x52\x35\x76\xe0\x9c\x7e\xc8\xf8\x5c\x68\x8a"
           "\x45\x93\x5d\xa0\x2b\xbd\x11\xa7\xff\xac\x3d\x4b\x5f\x2f\xd8\x1a\x38\x0a\x0f\x3a\x5b\x6d\xc0",
           119)}};
#endif
  const auto recorded = [&](std::size_t first, std::size_t last) {
    std::string out;
    for (std::size_t i = first; i <= last; ++i) {
      const TypedMessage& message = messages[i];
      for (const std::size_t byte : {message.type, std::size_t{message.second}, message.bytes.size() >> 8,
                                     message.bytes.size() & 255}) {
        out += static_cast<char>(byte);
      }
      out += message.bytes;
    }
    return out;
  };
  const std::string zero(1, '\0');
  const std::string own = "/own" + zero + "std_msgs/String" + zero + "string data\n";
  all["bag_made"] = {{"graph", "\1" + recorded(0, 2)},
                     {"radio", "\1" + recorded(3, 4)},
                     {"odometry", zero + recorded(4, 5)},
                     {"own", zero + "\6" + zero + zero + static_cast<char>(own.size()) + own + "\5\2" + zero +
                                 "\5\1" + std::string(3, '\0') + "a" + "\5\2" + zero + zero}};
  all["zip_archive"] = {{"lamp", zip({{"keys.csv", "6989586621679009792,pc_0.pcd,1600000000000000000\n"},
                                      {"pc_0.pcd", all["cloud_pcd"][1].second},
                                      {"pose_graph.bag", bag({messages[0]})}})},
                        {"clouds", zip({{"pcd/a0.pcd", all["cloud_pcd"][0].second}, {"pcd/", ""}})}};
  return all;
}

}  // namespace loopwise::fuzz
