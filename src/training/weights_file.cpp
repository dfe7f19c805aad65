// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/training/weights.hpp>

#include <cstdio>

#include <nlohmann/json.hpp>

#include <loopwise/io/atomic_file.hpp>
#include <loopwise/io/json_options.hpp>

namespace loopwise::training {

void write_weights(const std::filesystem::path& path, NetworkKind kind, const Tensors& tensors,
                   const std::string& meta_json) {
  Json meta = {{"kind", enum_name(kind)}};
  const Json more = parse_json(meta_json, "meta");
  for (const auto& [key, value] : more.items()) meta[key] = value;
  std::string text = "{\n\"__meta__\": " + meta.dump();
  char number[32];
  for (const auto& [name, tensor] : tensors) {
    text += ",\n\"" + name + "\": {\"shape\": [";
    for (std::size_t i = 0; i < tensor.shape.size(); ++i) {
      text += (i == 0 ? "" : ", ") + std::to_string(tensor.shape[i]);
    }
    text += "], \"data\": [";
    for (std::size_t i = 0; i < tensor.data.size(); ++i) {
      std::snprintf(number, sizeof number, "%.9g", static_cast<double>(tensor.data[i]));
      text += (i == 0 ? "" : ", ") + std::string(number);
    }
    text += "]}";
  }
  write_file(path, text + "\n}\n");
}

}  // namespace loopwise::training
