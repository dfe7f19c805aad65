// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <filesystem>
#include <memory>
#include <string>

#include <Eigen/Core>

namespace loopwise::detail {

/// Reads tensors of a weights file, JSON `{"__meta__": {...}, NAME: {"shape": [...], "data": [flat,
/// row-major]}, ...}`, and checks their shapes. Errors name file and tensor.
class TensorFile {
 public:
  /// \throws IoError; InputError if the file holds no JSON object
  explicit TensorFile(const std::filesystem::path& path);
  ~TensorFile();
  TensorFile(TensorFile&&) noexcept;

  [[nodiscard]] bool has(const std::string& name) const;
  /// The kind of network: `kind` of `__meta__`, "paper" if missing.
  [[nodiscard]] std::string kind() const;

  /// Sizes of 0 are taken from the file and returned through the matrix. \throws InputError on a tensor that
  /// is missing, has another shape or a value that is not finite.
  [[nodiscard]] Eigen::MatrixXd matrix(const std::string& name, Eigen::Index rows,
                                       Eigen::Index columns) const;
  [[nodiscard]] Eigen::RowVectorXd row(const std::string& name, Eigen::Index size) const {
    return matrix(name, 1, size);
  }

  [[noreturn]] void fail(const std::string& why) const;

 private:
  struct Impl;
  std::unique_ptr<const Impl> impl_;
};

}  // namespace loopwise::detail
