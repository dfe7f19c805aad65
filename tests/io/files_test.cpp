// SPDX-License-Identifier: BSD-3-Clause
#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cmath>
#include <cstdio>
#include <limits>

#include <loopwise/core/error.hpp>
#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/csv.hpp>

#include "testing.hpp"

namespace loopwise::files_test {
namespace {

using testing::TemporaryFolder;

std::size_t files_in(const std::filesystem::path& folder) {
  std::size_t count = 0;
  for ([[maybe_unused]] const auto& entry : std::filesystem::directory_iterator(folder)) ++count;
  return count;
}

TEST_CASE("files: written whole, replaced whole, nothing left beside them", "[io][files]") {
  const TemporaryFolder folder;
  const std::string large(3 << 20, 'x');
  for (const std::string& contents : {std::string(), std::string("one\0two", 7), large}) {
    write_file(folder / "a", contents);
    CHECK(read_file(folder / "a") == contents);
  }
  CHECK(files_in(folder.path()) == 1);
}

TEST_CASE("files: names as long as the system has them", "[io][files]") {
  const TemporaryFolder folder;
  const std::string longest(255, 'n');
  write_file(folder / longest, "contents");
  CHECK(read_file(folder / longest) == "contents");
  CHECK(files_in(folder.path()) == 1);
  CHECK(plain_file_name("K\xc3\xb6ln 1.b-") == "K__ln_1_b-");
  CHECK(plain_file_name(longest) == std::string(100, 'n'));
}

TEST_CASE("files: flushed now or later; a device is accepted, a missing file is an error",
          "[io][files][error]") {
  const TemporaryFolder folder;
  for (const Flush flush : {Flush::kNow, Flush::kLater}) {
    write_file(folder / "a", "contents", flush);
    CHECK(read_file(folder / "a") == "contents");
    CHECK(files_in(folder.path()) == 1);
  }
  flush_file(folder / "a");
  flush_file(folder.path());
  flush_file_system(folder.path());
  flush_file("/dev/null");
  CHECK_THROWS_WITH(flush_file(folder / "b"), Contains("b: No such file"));
  CHECK_THROWS_WITH(flush_file_system(folder / "c"), Contains("c: No such file"));
}

TEST_CASE("files: standard output that goes to a file is appended to, not replaced", "[io][files]") {
  const TemporaryFolder folder;
  testing::write_text(folder / "log", "before\n");
  std::fflush(stdout);
  const int saved = ::dup(STDOUT_FILENO);
  const int log = ::open((folder / "log").c_str(), O_WRONLY | O_APPEND);
  REQUIRE(::dup2(log, STDOUT_FILENO) == STDOUT_FILENO);
  std::string why;
  try {
    write_file("/dev/stdout", "result\n");
  } catch (const IoError& error) {
    why = error.what();
  }
  ::dup2(saved, STDOUT_FILENO);
  ::close(saved);
  ::close(log);
  CHECK(why.empty());
  CHECK(read_file(folder / "log") == "before\nresult\n");
  CHECK(files_in(folder.path()) == 1);
}

TEST_CASE("files: a failed write leaves the old contents", "[io][files][error]") {
  const TemporaryFolder folder;
  std::filesystem::create_directory(folder / "d");
  CHECK_THROWS_WITH(write_file(folder / "d", "x"), Contains("is a folder"));
  CHECK_THROWS_WITH(write_file(folder / "none" / "a", "x"), Contains("No such file"));
  CHECK_THROWS_WITH(read_file(folder / "d"), Contains("is a folder"));
  CHECK_THROWS_WITH(read_file(folder / "b"), Contains("b: No such file"));
  CHECK(files_in(folder.path()) == 1);
}

TEST_CASE("files: permissions and links of the replaced file stay", "[io][files]") {
  const TemporaryFolder folder;
  write_file(folder / "a", "old");
  REQUIRE(::chmod((folder / "a").c_str(), 0640) == 0);
  std::filesystem::create_symlink("a", folder / "link");
  write_file(folder / "link", "new");
  CHECK(std::filesystem::is_symlink(folder / "link"));
  CHECK(read_file(folder / "a") == "new");
  struct stat status {};
  REQUIRE(::stat((folder / "a").c_str(), &status) == 0);
  CHECK((status.st_mode & 0777) == 0640);
}

TEST_CASE("files: a device is written to, not replaced", "[io][files]") {
  write_file("/dev/null", "gone");
  CHECK(std::filesystem::is_character_file("/dev/null"));
}

CsvTable table(const std::string& text) {
  const TemporaryFolder folder;
  testing::write_text(folder / "t.csv", text);
  return CsvTable(folder / "t.csv", {"key", "name", "value"});
}

TEST_CASE("csv: written numbers are read back to the same bits", "[io][csv]") {
  const double tiny = std::numeric_limits<double>::denorm_min(), odd = 0.1 + 0.2;
  CsvText text({"key", "name", "value"});
  text.row(~Key{0}, "plain", odd)
      .row(Key{1}, "with, comma", -tiny)
      .row(2, "a \"quote\"\nand a line", std::nan(""))
      .row(-3, " blanks ", 1e300);
  const CsvTable back = table(text.text());
  REQUIRE(back.size() == 4);
  CHECK(back.key(0, 0) == ~Key{0});
  CHECK(back.number(0, 2) == odd);
  CHECK(back.text(1, 1) == "with, comma");
  CHECK(back.number(1, 2) == -tiny);
  CHECK(back.text(2, 1) == "a \"quote\"\nand a line");
  CHECK(std::isnan(back.number_or_nan(2, 2)));
  CHECK(back.integer(3, 0) == -3);
  CHECK(back.text(3, 1) == " blanks ");
  CHECK(back.line(3) == 6);  // the quoted line end counts
  CHECK_THROWS_AS(text.row(1, 2), InputError);
}

TEST_CASE("csv: line ends of other systems, blanks and empty lines do no harm", "[io][csv]") {
  const CsvTable back = table("key, name ,value\r\n\r\na12 ,\"x\" , 1.5\r\n");
  REQUIRE(back.size() == 1);
  CHECK(back.key(0, 0) == make_key('a', 12));
  CHECK(back.text(0, 1) == "x");
  CHECK(back.number(0, 2) == 1.5);
}

TEST_CASE("csv: errors name file, line and column", "[io][csv][error]") {
  CHECK_THROWS_WITH(table(""), Contains("t.csv:1: is empty, expected the header \"key,name,value\""));
  CHECK_THROWS_WITH(table("key,value\n"), Contains("t.csv:1: header is \"key,value\""));
  CHECK_THROWS_WITH(table("key,name,value\n1,2\n"), Contains("t.csv:2: 2 values, expected 3"));
  CHECK_THROWS_WITH(table("key,name,value\n1,\"x,3\n"), Contains("t.csv:2: a quoted value is not closed"));
  CHECK_THROWS_WITH(table("key,name,value\n1,\"x\"y,3\n"), Contains("t.csv:2: text after a quoted value"));
  const CsvTable bad = table("key,name,value\n-1,1.5,inf\n18446744073709551616,,x\n");
  CHECK_THROWS_WITH(bad.key(0, 0), Contains("t.csv:2: column \"key\": \"-1\" is not a key"));
  CHECK_THROWS_WITH(bad.key(1, 0), Contains("t.csv:3: column \"key\""));
  CHECK_THROWS_WITH(bad.integer(0, 1), Contains("column \"name\": \"1.5\" is not a 64-bit whole number"));
  CHECK_THROWS_WITH(bad.number(0, 2), Contains("column \"value\": \"inf\" is not finite"));
  CHECK_THROWS_WITH(bad.number(1, 2), Contains("t.csv:3: column \"value\": \"x\" is not a number"));
  CHECK_THROWS_WITH(bad.number(1, 1), Contains("column \"name\""));
}

}  // namespace
}  // namespace loopwise::files_test
