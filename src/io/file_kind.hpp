// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// Recognises files and folders of other kinds, so that a reader can name them in its error. Private to io.
#pragma once

#include <cstddef>
#include <filesystem>
#include <initializer_list>
#include <string>
#include <string_view>

namespace loopwise {

/// Kinds of files that users may give by mistake, recognised by their first bytes.
enum class FileKind {
  kUnknown,  ///< Possibly the expected kind.
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

/// Number of bytes from the beginning of a file that suffice to recognise it.
inline constexpr std::size_t kKindBytes = 4096;

/// \param beginning the first kKindBytes bytes, or all of a shorter file
[[nodiscard]] FileKind file_kind(std::string_view beginning);

/// Throws if the text is of a known kind other than the accepted ones. `wanted` names the expected kind, for
/// example "a g2o file". \throws InputError naming the found kind and the remedy
void refuse_foreign(std::string_view text, const std::string& name, std::initializer_list<FileKind> accepted,
                    const std::string& wanted);

/// The same for a file that is not read yet. Accepts files that are not regular. \throws IoError as well
void refuse_foreign_file(const std::filesystem::path& file, std::initializer_list<FileKind> accepted,
                         const std::string& wanted);

/// The same for files of numbers, which have no mark of their own. Uses only marks of six bytes or more,
/// which numbers hardly ever form.
void refuse_foreign_numbers(std::string_view bytes, const std::string& name, const std::string& wanted);

/// Describes a folder without a mission, with a remedy; empty if nothing is known about it. \throws IoError
[[nodiscard]] std::string describe_foreign_folder(const std::filesystem::path& folder);

}  // namespace loopwise
