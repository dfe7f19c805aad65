// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/distributed/transport.hpp>

#include <deque>
#include <mutex>

#include <loopwise/core/error.hpp>

namespace loopwise {
namespace {

struct Mailbox {
  std::mutex mutex;
  std::deque<Message> messages;
};

class LocalTransport final : public Transport {
 public:
  LocalTransport(int rank, std::shared_ptr<std::vector<Mailbox>> mailboxes)
      : rank_(rank), mailboxes_(std::move(mailboxes)) {}

  [[nodiscard]] int rank() const override { return rank_; }
  [[nodiscard]] int size() const override { return static_cast<int>(mailboxes_->size()); }

  void send(int to, int tag, std::string_view bytes) override {
    if (to < 0 || to >= size()) throw InputError("rank " + std::to_string(to) + " does not exist");
    Mailbox& box = (*mailboxes_)[static_cast<std::size_t>(to)];
    const std::lock_guard<std::mutex> lock(box.mutex);
    box.messages.push_back({rank_, tag, std::string(bytes)});
  }

  [[nodiscard]] std::optional<Message> receive() override {
    Mailbox& box = (*mailboxes_)[static_cast<std::size_t>(rank_)];
    const std::lock_guard<std::mutex> lock(box.mutex);
    if (box.messages.empty()) return std::nullopt;
    Message message = std::move(box.messages.front());
    box.messages.pop_front();
    return message;
  }

 private:
  int rank_;
  std::shared_ptr<std::vector<Mailbox>> mailboxes_;
};

}  // namespace

std::vector<std::unique_ptr<Transport>> local_transports(int size) {
  if (size < 1) throw OptionError("size = " + std::to_string(size) + ", must be >= 1");
  const auto mailboxes = std::make_shared<std::vector<Mailbox>>(static_cast<std::size_t>(size));
  std::vector<std::unique_ptr<Transport>> all;
  all.reserve(mailboxes->size());
  for (int rank = 0; rank < size; ++rank) all.push_back(std::make_unique<LocalTransport>(rank, mailboxes));
  return all;
}

}  // namespace loopwise
