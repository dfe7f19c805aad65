// SPDX-License-Identifier: BSD-3-Clause
#include "file_kind.hpp"

#include <algorithm>
#include <fstream>

#include <loopwise/core/error.hpp>
#include <loopwise/io/cloud.hpp>

#include "mission_parts.hpp"
#include "text.hpp"

namespace loopwise {
namespace {

namespace fs = std::filesystem;
using namespace std::string_view_literals;

struct Mark {
  FileKind kind;
  std::string_view bytes;
  std::size_t at = 0;
};

constexpr Mark kMarks[] = {
    {FileKind::kGitLfsPointer, "version https://git-lfs"sv},
    {FileKind::kGitAnnexPointer, "/annex/objects/"sv},
    {FileKind::kSqlite, "SQLite format 3\0"sv},
    {FileKind::kMcap, "\x89MCAP0\r\n"sv},
    {FileKind::kBag, "#ROSBAG V"sv},
    {FileKind::kOldBag, "#ROSLOG V"sv},
    {FileKind::kPcd, "# .PCD"sv},
    {FileKind::kPcd, "VERSION 0.7\n"sv},
    {FileKind::kPcd, "VERSION .7\n"sv},
    {FileKind::kPly, "ply\nformat"sv},
    {FileKind::kPly, "ply\r\nformat"sv},
    {FileKind::kLas, "LASF"sv},
    {FileKind::kE57, "ASTM-E57"sv},
    {FileKind::kNumpy, "\x93NUMPY"sv},
    {FileKind::kMat, "MATLAB 5.0"sv},
    {FileKind::kHdf5, "\x89HDF\r\n\x1a\n"sv},
    {FileKind::kZip, "PK\x03\x04"sv},
    {FileKind::kZip, "PK\x05\x06"sv},
    {FileKind::kCompressed, "\x1f\x8b\x08"sv},
    {FileKind::kCompressed, "BZh"sv},
    {FileKind::kCompressed,
     "\xfd"
     "7zXZ\0"sv},
    {FileKind::kCompressed, "7z\xbc\xaf\x27\x1c"sv},
    {FileKind::kCompressed, "\x28\xb5\x2f\xfd"sv},
    {FileKind::kCompressed, "\x04\x22\x4d\x18"sv},
    {FileKind::kTar, "ustar"sv, 257},
    {FileKind::kImage, "\x89PNG\r\n"sv},
    {FileKind::kImage, "\xff\xd8\xff"sv},
    {FileKind::kPdf, "%PDF-"sv},
    {FileKind::kProgram,
     "\x7f"
     "ELF"sv},
    {FileKind::kPickle, "\x80\x02"sv},
    {FileKind::kPickle, "\x80\x03"sv},
    {FileKind::kPickle, "\x80\x04\x95"sv},
    {FileKind::kPickle, "\x80\x05\x95"sv},
    {FileKind::kYaml, "%YAML"sv},
    {FileKind::kYaml, "---\n"sv},
    {FileKind::kYaml, "rosbag2_bagfile_information:"sv},
};

const Mark* mark_of(std::string_view text) {
  for (const Mark& mark : kMarks) {
    if (text.size() >= mark.at && text.substr(mark.at, mark.bytes.size()) == mark.bytes) return &mark;
  }
  return nullptr;
}

bool is_decimal(std::string_view word) {
  double value = 0.0;
  return text::parse_double(word, value) == text::Number::kOk;
}

/// Kind of a text, from its first line that is neither blank nor a comment.
FileKind kind_of_text(std::string_view beginning) {
  text::Lines lines(beginning);
  for (std::string_view line; lines.next(line);) {
    const std::string_view first = text::next_word(line);
    if (first.empty()) continue;
    if (first[0] == '<') return FileKind::kMarkup;
    if (first[0] == '{' || first[0] == '[') return FileKind::kJson;
    for (const std::string_view tag : {"VERTEX", "EDGE", "FIX", "PARAMS_"}) {
      if (first.substr(0, tag.size()) == tag) return FileKind::kG2o;
    }
    std::size_t words = 1;
    bool numbers = is_decimal(first);
    for (std::string_view word; !(word = text::next_word(line)).empty(); ++words)
      numbers = numbers && is_decimal(word);
    // A line that is cut off is not judged.
    if (!numbers || !(lines.ended() || beginning.size() < kKindBytes)) return FileKind::kUnknown;
    return words == 8 || words == 9 ? FileKind::kTum : words == 12 ? FileKind::kKitti : FileKind::kUnknown;
  }
  return FileKind::kUnknown;
}

struct Description {
  FileKind kind;
  const char* what;
  const char* advice;
};

constexpr const char* kBagAdvice = "give it as a mission: 'loopwise info', 'convert' and 'replay' read it";
constexpr const char* kUnpack = "unpack it first";
constexpr const char* kCloudAdvice =
    "'loopwise info' and 'register' read a cloud alone, by the ending of its name; a mission needs poses "
    "too, "
    "beside Scans/ or in a graph";
constexpr const char* kTrajectoryAdvice =
    "'loopwise evaluate' reads it; as odom_poses.txt (KITTI rows) beside Scans/ poses are a session";

constexpr Description kDescriptions[] = {
    {FileKind::kEmpty, "empty", "it was perhaps not completely written or downloaded"},
    {FileKind::kGitLfsPointer, "a pointer of Git LFS, not the data", "run 'git lfs pull' in its repository"},
    {FileKind::kGitAnnexPointer, "a pointer of git-annex, not the data",
     "run 'git annex get' in its repository"},
    {FileKind::kSqlite, "an SQLite database, as ROS 2 records (.db3)", kBagAdvice},
    {FileKind::kMcap, "an MCAP recording, as ROS 2 records", kBagAdvice},
    {FileKind::kBag, "a ROS 1 bag", kBagAdvice},
    {FileKind::kOldBag, "a bag of an old version of ROS 1", "convert it to version 2.0 with 'rosbag fix'"},
    {FileKind::kPcd, "a PCD cloud", kCloudAdvice},
    {FileKind::kPly, "a PLY cloud", kCloudAdvice},
    {FileKind::kLas, "a LAS or LAZ cloud",
     "convert it to PCD or PLY, for example with 'pdal translate in.las out.ply'"},
    {FileKind::kE57, "an E57 cloud", "convert it to PCD or PLY, for example with CloudCompare or pdal"},
    {FileKind::kNumpy, "an array of NumPy", "write it as PCD or PLY, or in Python with loopwise.write_pcd"},
    {FileKind::kMat, "a MATLAB file", "export its numbers as text"},
    {FileKind::kHdf5, "an HDF5 file", "export its data as clouds and poses"},
    {FileKind::kZip, "a zip archive", kUnpack},
    {FileKind::kCompressed, "a compressed file", kUnpack},
    {FileKind::kTar, "a tar archive", kUnpack},
    {FileKind::kImage, "an image", "is it the file that you meant?"},
    {FileKind::kPdf, "a PDF document", "is it the file that you meant?"},
    {FileKind::kProgram, "a program", "is it the file that you meant?"},
    {FileKind::kPickle, "a pickle of Python", "write its data as text in the program that made it"},
    {FileKind::kMarkup, "a web page or XML", "a download may have saved an error page: open it to check"},
    {FileKind::kJson, "JSON", "a mission is given by its folder, options by --config"},
    {FileKind::kYaml, "YAML", "a bag of ROS 2 is given by its folder or by its .db3 or .mcap file"},
    {FileKind::kG2o, "a g2o graph", "give it as a mission or to 'loopwise optimize'"},
    {FileKind::kTum, "lines of 8 or 9 numbers, as in TUM trajectories", kTrajectoryAdvice},
    {FileKind::kKitti, "lines of 12 numbers, as in KITTI poses", kTrajectoryAdvice},
};

[[noreturn]] void refuse(FileKind kind, const std::string& name, const std::string& wanted) {
  const auto* const found = std::find_if(std::begin(kDescriptions), std::end(kDescriptions),
                                         [kind](const Description& d) { return d.kind == kind; });
  throw InputError(name + ": is " + found->what + ", expected " + wanted + ": " + found->advice);
}

std::string beginning_of(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  if (!in) throw IoError(file.string(), "cannot be opened");
  std::string start(kKindBytes, '\0');
  in.read(start.data(), static_cast<std::streamsize>(start.size()));
  if (in.bad()) throw IoError(file.string(), "cannot be read");
  start.resize(static_cast<std::size_t>(in.gcount()));
  return start;
}

}  // namespace

FileKind file_kind(std::string_view text) {
  const std::string_view beginning = text.substr(0, kKindBytes);
  if (beginning.empty()) return FileKind::kEmpty;
  if (const Mark* mark = mark_of(beginning)) return mark->kind;
  return beginning.find('\0') == std::string_view::npos ? kind_of_text(beginning) : FileKind::kUnknown;
}

void refuse_foreign(std::string_view text, const std::string& name, std::initializer_list<FileKind> accepted,
                    const std::string& wanted) {
  const FileKind kind = file_kind(text);
  if (kind == FileKind::kUnknown || std::find(accepted.begin(), accepted.end(), kind) != accepted.end())
    return;
  refuse(kind, name, wanted);
}

void refuse_foreign_file(const fs::path& file, std::initializer_list<FileKind> accepted,
                         const std::string& wanted) {
  std::error_code unknown;
  if (fs::is_regular_file(file, unknown)) refuse_foreign(beginning_of(file), file.string(), accepted, wanted);
}

void refuse_foreign_numbers(std::string_view bytes, const std::string& name, const std::string& wanted) {
  constexpr std::size_t kSure = 6;
  const Mark* mark = mark_of(bytes.substr(0, kKindBytes));
  if (mark != nullptr && mark->at == 0 && mark->bytes.size() >= kSure) refuse(mark->kind, name, wanted);
}

namespace {

/// The first line of poses that rtabmap-export writes by default.
bool is_rtabmap_poses(const fs::path& file) {
  return file.extension() == ".txt" && fs::is_regular_file(file) &&
         parts::begins_with(file, "#timestamp x y z qx qy qz qw");
}

}  // namespace

std::string describe_foreign_folder(const fs::path& folder) {
  const std::vector<fs::path> entries = parts::entries(folder);
  const auto has = [&](const char* name) { return parts::exists(folder / name); };
  if (entries.empty()) return "is an empty folder";
  if (has("sequences"))
    return "has KITTI's odometry data: give one of its sequences, for example sequences/00";
  if (has("velodyne") || has("velodyne_points") ||
      (has("calib.txt") && (has("image_0") || has("image_2") || has("times.txt"))))
    return "has KITTI's odometry data, but no clouds in velodyne/: a sequence needs velodyne/NUMBER.bin, "
           "times.txt, calib.txt and poses.txt (or --poses FILE)";
  if (has("times.txt") && (has("Scans") || has("scans")))
    return "is a session without poses: its program saves optimized_poses.txt at its end, but was stopped "
           "before";
  if (has("transformations.pcd") && has("trajectory.pcd"))
    return "is a map saved by LIO-SAM, which does not save the scans of key frames: replay its run with "
           "SC-LIO-SAM, "
           "which saves Scans/, or give clouds named by their stamps and its trajectory in TUM format";
  if (std::any_of(entries.begin(), entries.end(), is_rtabmap_poses))
    return "has poses written by rtabmap-export, but only the database has the scans of its nodes: give "
           "its .db";
  if (std::any_of(entries.begin(), entries.end(), [](const fs::path& entry) { return is_cloud_file(entry); }))
    return "has clouds without poses: add a graph beside them (result.g2o, clouds named by its ids), "
           "move them to Scans/ beside an odom_poses.txt, or name them by their stamps beside a "
           "trajectory in TUM format";
  return "";
}

}  // namespace loopwise
