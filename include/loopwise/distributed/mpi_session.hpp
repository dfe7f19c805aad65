// SPDX-License-Identifier: BSD-3-Clause
#pragma once

#include <memory>
#include <string>

#include <loopwise/core/export.hpp>
#include <loopwise/distributed/transport.hpp>

namespace loopwise {

/// Whether a launcher (mpirun, srun) has started this process as one of several. Reads only the environment
/// and does not start MPI.
[[nodiscard]] LOOPWISE_EXPORT bool started_by_mpi();

/// This process as a rank of an MPI job, from construction to destruction. A process can have only one.
class LOOPWISE_EXPORT MpiSession {
 public:
  /// \throws Error if MPI cannot be started, or does not support serialised calls from several threads
  MpiSession();
  /// Ends MPI, which waits for all ranks.
  ~MpiSession();
  /// Ends the whole job, also ranks that hang, with this exit status. Does not return.
  [[noreturn]] void abort(int status);
  MpiSession(const MpiSession&) = delete;
  MpiSession& operator=(const MpiSession&) = delete;

  /// Messages to the other ranks; lives as long as the session.
  [[nodiscard]] Transport& transport() { return *transport_; }
  /// Host of this rank, for messages to users.
  [[nodiscard]] const std::string& host() const { return host_; }

 private:
  std::unique_ptr<Transport> transport_;
  std::string host_;
};

}  // namespace loopwise
