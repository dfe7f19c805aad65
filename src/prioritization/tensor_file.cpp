// SPDX-License-Identifier: BSD-3-Clause
#include "tensor_file.hpp"

#include <cmath>
#include <cstdint>
#include <fstream>
#include <limits>
#include <vector>

#include <nlohmann/json.hpp>

#include <loopwise/core/error.hpp>

namespace loopwise::detail {

using Json = nlohmann::json;
using Eigen::Index;

namespace {

constexpr Index kLargestSize = std::numeric_limits<std::int32_t>::max();

}  // namespace

struct TensorFile::Impl {  // NOLINT(bugprone-exception-escape): of the JSON library's own
  std::string path;
  Json json;
};

TensorFile::TensorFile(const std::filesystem::path& path) {
  auto impl = std::make_unique<Impl>();
  impl->path = path.string();
  std::ifstream in(path);
  if (!in) throw IoError(impl->path, "cannot be opened");
  try {
    impl->json = Json::parse(in);
  } catch (const Json::exception& error) {
    throw InputError(impl->path + ": " + error.what());
  }
  if (!impl->json.is_object()) throw InputError(impl->path + ": expected an object of tensors");
  impl_ = std::move(impl);
}

TensorFile::~TensorFile() = default;
TensorFile::TensorFile(TensorFile&&) noexcept = default;

bool TensorFile::has(const std::string& name) const {
  return impl_->json.contains(name);
}

std::string TensorFile::kind() const {
  const auto meta = impl_->json.find("__meta__");
  if (meta == impl_->json.end() || !meta->is_object() || !meta->contains("kind")) return "paper";
  const Json& kind = meta->at("kind");
  if (!kind.is_string()) fail("__meta__.kind: expected text");
  return kind.get<std::string>();
}

Eigen::MatrixXd TensorFile::matrix(const std::string& name, Index rows, Index columns) const {
  const auto found = impl_->json.find(name);
  const auto fail_here = [&](const std::string& why) { fail(name + ": " + why); };
  if (found == impl_->json.end()) fail_here("missing");
  std::vector<Index> shape;
  std::vector<double> data;
  try {
    if (!found->at("shape").is_array()) fail_here("shape: expected whole numbers");
    for (const Json& size : found->at("shape")) {
      // Sizes are clamped at a bound that no data can fill; a check below rejects them.
      if (!size.is_number_integer()) fail_here("shape: expected whole numbers");
      shape.push_back(size.is_number_unsigned() && size.get<std::uint64_t>() > kLargestSize
                          ? kLargestSize
                          : size.get<Index>());
    }
    data = found->at("data").get<std::vector<double>>();
  } catch (const Json::exception&) {
    fail_here("expected {\"shape\": [integers], \"data\": [numbers]}");
  }
  if (shape.size() == 1) shape.insert(shape.begin(), 1);
  if (shape.size() != 2 || shape[0] < 1 || shape[1] < 1 || (rows > 0 && shape[0] != rows) ||
      (columns > 0 && shape[1] != columns)) {
    std::string text;
    for (const Index s : shape) text += (text.empty() ? "" : "x") + std::to_string(s);
    fail_here("shape " + text + ", expected " + (rows > 0 ? std::to_string(rows) : "any") + "x" +
              (columns > 0 ? std::to_string(columns) : "any"));
  }
  // Both sizes are below 2^31, so this does not overflow.
  const Index wanted = shape[0] * shape[1];
  if (static_cast<Index>(data.size()) != wanted) {
    fail_here(std::to_string(data.size()) + " values, expected " + std::to_string(wanted));
  }
  for (const double value : data) {
    if (!std::isfinite(value)) fail_here("a value is not finite");
  }
  return Eigen::Map<const Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>>(
      data.data(), shape[0], shape[1]);
}

void TensorFile::fail(const std::string& why) const {
  throw InputError(impl_->path + ": " + why);
}

}  // namespace loopwise::detail
