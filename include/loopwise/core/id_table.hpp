// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <array>
#include <bitset>
#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <utility>

namespace loopwise {

/// Values by number, for ascending numbers such as those of candidates. Numbers are stored in blocks, which
/// need much less time and memory than a tree or a hash table. All numbers are allowed. Iteration is in
/// ascending order.
template <class T>
class IdTable {
 public:
  IdTable() = default;
  /// Moves the contents of the other table.
  IdTable(IdTable&& other) noexcept { swap(other); }
  /// Exchanges the contents.
  IdTable& operator=(IdTable&& other) noexcept { return swap(other); }

  /// Number of values.
  [[nodiscard]] std::size_t size() const { return size_; }
  /// Whether there is no value.
  [[nodiscard]] bool empty() const { return size_ == 0; }

  /// The value of a number, or null. Valid until that number is erased.
  [[nodiscard]] T* find(std::uint64_t id) {
    Block* block = block_of(id);
    return block != nullptr && block->held[id % kBlock] ? &block->values[id % kBlock] : nullptr;
  }
  /// The same for a constant table.
  [[nodiscard]] const T* find(std::uint64_t id) const {
    const auto block = blocks_.find(id / kBlock);
    return block != blocks_.end() && block->second->held[id % kBlock] ? &block->second->values[id % kBlock]
                                                                      : nullptr;
  }
  /// Whether the number has a value.
  [[nodiscard]] bool contains(std::uint64_t id) const { return find(id) != nullptr; }

  /// Sets the value of a number. \returns whether the number is new
  bool set(std::uint64_t id, T value) {
    Block* block = block_of(id);
    if (block == nullptr) {
      block = blocks_.emplace(id / kBlock, std::make_unique<Block>()).first->second.get();
      last_ = {id / kBlock, block};
    }
    block->values[id % kBlock] = std::move(value);
    if (block->held[id % kBlock]) return false;
    block->held.set(id % kBlock);
    ++block->count;
    ++size_;
    return true;
  }

  /// Erases the value of a number. \returns whether there was one
  bool erase(std::uint64_t id) {
    Block* block = block_of(id);
    if (block == nullptr || !block->held[id % kBlock]) return false;
    block->held.reset(id % kBlock);
    --size_;
    if (--block->count == 0) {
      last_ = {};
      blocks_.erase(id / kBlock);
    }
    return true;
  }

  /// Erases all.
  void clear() {
    blocks_.clear();
    last_ = {};
    size_ = 0;
  }

  /// Calls visitor(id, value) in ascending order until it returns false.
  template <class Visitor>
  void visit(Visitor&& visitor) const {
    for (const auto& [number, block] : blocks_) {
      for (std::size_t i = 0; i < kBlock; ++i) {
        if (block->held[i] && !visitor(number * kBlock + i, block->values[i])) return;
      }
    }
  }

 private:
  static constexpr std::size_t kBlock = 1024;
  struct Block {
    std::array<T, kBlock> values{};
    std::bitset<kBlock> held;
    std::size_t count = 0;
  };

  IdTable& swap(IdTable& other) noexcept {
    blocks_.swap(other.blocks_);
    std::swap(last_, other.last_);
    std::swap(size_, other.size_);
    return *this;
  }

  [[nodiscard]] Block* block_of(std::uint64_t id) {
    if (last_.second != nullptr && last_.first == id / kBlock) return last_.second;
    const auto found = blocks_.find(id / kBlock);
    if (found == blocks_.end()) return nullptr;
    last_ = {found->first, found->second.get()};
    return last_.second;
  }

  std::map<std::uint64_t, std::unique_ptr<Block>> blocks_;
  std::pair<std::uint64_t, Block*> last_{0, nullptr};  // last used block: most changes are near it
  std::size_t size_ = 0;
};

}  // namespace loopwise
