// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// What a file or folder of another kind is, so that a reader that cannot use it says so. Private to io.
#pragma once

#include <cstddef>
#include <filesystem>
#include <initializer_list>
#include <string>
#include <string_view>

namespace loopwise {

/// Kinds of files that people give in the place of others, by their first bytes.
enum class FileKind {
  kUnknown,  ///< Perhaps the right one.
  kEmpty,
  kGitLfsPointer,
  kGitAnnexPointer,
  kSqlite,
  kMcap,
  kBag,
  kOldBag,
  kPcd,
  kPly,
  kLas,
  kE57,
  kNumpy,
  kMat,
  kHdf5,
  kZip,
  kCompressed,
  kTar,
  kImage,
  kPdf,
  kProgram,
  kPickle,
  kMarkup,
  kJson,
  kYaml,
  kG2o,
  kTum,
  kKitti,
};

/// So many bytes from a file's beginning are enough.
inline constexpr std::size_t kKindBytes = 4096;

/// By the first kKindBytes, or all of a shorter file.
[[nodiscard]] FileKind file_kind(std::string_view beginning);

/// Throws if the text is of a known kind that is neither unknown nor among these. `wanted` says what was
/// expected, for example "a g2o file". \throws InputError naming what it is and what to do
void refuse_foreign(std::string_view text, const std::string& name, std::initializer_list<FileKind> accepted,
                    const std::string& wanted);

/// The same of a file that is not read yet; other kinds of files than regular ones pass. \throws IoError too
void refuse_foreign_file(const std::filesystem::path& file, std::initializer_list<FileKind> accepted,
                         const std::string& wanted);

/// The same for files of numbers without any mark of their own: only by marks of six bytes and more, which
/// numbers hardly make up.
void refuse_foreign_numbers(std::string_view bytes, const std::string& name, const std::string& wanted);

/// What a folder is that no mission is in, and what to do; empty if nothing is known of it. \throws IoError
[[nodiscard]] std::string describe_foreign_folder(const std::filesystem::path& folder);

}  // namespace loopwise
