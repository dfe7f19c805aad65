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

std::set<std::string> missions_of_weights(const std::filesystem::path& path) {
  std::set<std::string> out;
  const Json json = read_json_file(path);
  if (!json.is_object() || !json.contains("__meta__")) return out;
  const Json& meta = json["__meta__"];
  if (!meta.is_object() || !meta.contains("missions") || !meta["missions"].is_object()) return out;
  for (const auto& [role, names] : meta["missions"].items()) {
    for (const Json& name : names) {
      if (name.is_string()) out.insert(name.get<std::string>());
    }
  }
  return out;
}

}  // namespace loopwise::training
