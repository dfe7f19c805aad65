// SPDX-License-Identifier: BSD-3-Clause
// Packed files of the training: the first byte and the second are the size of a matrix.
#include "packed.hpp"

#include "target.hpp"

LOOPWISE_FUZZ_TARGET(packed, bytes) {
  using namespace loopwise;
  const auto rows = static_cast<Eigen::Index>(fuzz::take_choice(bytes, 256));
  const auto columns = static_cast<Eigen::Index>(fuzz::take_choice(bytes, 256));
  const auto file = fuzz::scratch() / "packed.cbor";
  fuzz::put_file(file, bytes);
  const auto value = fuzz::attempt([&] { return training::read_packed(file, "loopwise-fuzz", 1); });
  if (!value) return;
  const training::Field whole("packed.cbor", *value);
  for (const auto& item : value->items()) {
    const training::Field field = whole[item.key()];
    static_cast<void>(fuzz::attempt([&] { return field.items(); }));
    static_cast<void>(fuzz::attempt([&] { return field.text(); }));
    static_cast<void>(fuzz::attempt([&] { return field.flag(); }));
    static_cast<void>(fuzz::attempt([&] { return field.integer(); }));
    const auto number = fuzz::attempt([&] { return field.number(); });
    fuzz::expect(!number || std::isfinite(*number), "numbers are finite");
    static_cast<void>(fuzz::attempt([&] { return field.values<float>(); }));
    const auto matrix = fuzz::attempt([&] { return field.matrix<double>(rows, columns); });
    fuzz::expect(!matrix || (matrix->rows() == rows && matrix->allFinite()), "matrices are as asked for");
  }
}
