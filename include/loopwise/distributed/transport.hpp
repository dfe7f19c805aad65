// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <loopwise/core/export.hpp>

namespace loopwise {

/// A message between two ranks. Bytes are in the sender's order, so all ranks must have the same
/// architecture.
struct Message {
  int from = 0;       ///< Rank of the sender.
  int tag = 0;        ///< Its kind.
  std::string bytes;  ///< Its contents.
};

/// Messages between the ranks of a job, numbered from 0. Messages from one rank to another arrive in the
/// order in which they were sent. Used by one thread at a time.
class LOOPWISE_EXPORT Transport {
 public:
  virtual ~Transport() = default;
  /// Rank of this process, from 0.
  [[nodiscard]] virtual int rank() const = 0;
  /// Number of ranks.
  [[nodiscard]] virtual int size() const = 0;
  /// Returns soon; the message may arrive later. \throws Error if the rank cannot be reached any more
  virtual void send(int to, int tag, std::string_view bytes) = 0;
  /// The next message, or empty if no message has arrived. Never waits. \throws Error
  [[nodiscard]] virtual std::optional<Message> receive() = 0;
};

/// Ranks that are threads of this process, for tests and for measurements of a server. Each may be used from
/// its own thread.
[[nodiscard]] LOOPWISE_EXPORT std::vector<std::unique_ptr<Transport>> local_transports(int size);

}  // namespace loopwise
