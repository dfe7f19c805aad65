// SPDX-License-Identifier: BSD-3-Clause
#include <loopwise/distributed/mpi_session.hpp>

#include <climits>
#include <cstdlib>
#include <list>

#include <mpi.h>

#include <loopwise/core/error.hpp>

namespace loopwise {
namespace {

void check(int code, const char* what) {
  if (code == MPI_SUCCESS) return;
  char text[MPI_MAX_ERROR_STRING];
  int length = 0;
  MPI_Error_string(code, text, &length);
  throw Error(std::string("MPI: ") + what + ": " + std::string(text, static_cast<std::size_t>(length)));
}

class MpiTransport final : public Transport {
 public:
  MpiTransport() {
    check(MPI_Comm_dup(MPI_COMM_WORLD, &communicator_), "MPI_Comm_dup");
    check(MPI_Comm_set_errhandler(communicator_, MPI_ERRORS_RETURN), "MPI_Comm_set_errhandler");
    check(MPI_Comm_rank(communicator_, &rank_), "MPI_Comm_rank");
    check(MPI_Comm_size(communicator_, &size_), "MPI_Comm_size");
  }
  ~MpiTransport() override {
    for (Sending& sending : sending_) MPI_Wait(&sending.request, MPI_STATUS_IGNORE);
    MPI_Comm_free(&communicator_);
  }
  MpiTransport(const MpiTransport&) = delete;
  MpiTransport& operator=(const MpiTransport&) = delete;

  [[nodiscard]] int rank() const override { return rank_; }
  [[nodiscard]] int size() const override { return size_; }

  void send(int to, int tag, std::string_view bytes) override {
    if (bytes.size() > INT_MAX)
      throw Error("MPI: a message of " + std::to_string(bytes.size()) + " bytes is too long");
    forget_sent();
    Sending& sending = sending_.emplace_back();
    sending.bytes = bytes;
    check(MPI_Isend(sending.bytes.data(), static_cast<int>(bytes.size()), MPI_BYTE, to, tag, communicator_,
                    &sending.request),
          "MPI_Isend");
  }

  [[nodiscard]] std::optional<Message> receive() override {
    forget_sent();
    int there = 0;
    MPI_Status status;
    MPI_Message handle;
    check(MPI_Improbe(MPI_ANY_SOURCE, MPI_ANY_TAG, communicator_, &there, &handle, &status), "MPI_Improbe");
    if (there == 0) return std::nullopt;
    int size = 0;
    check(MPI_Get_count(&status, MPI_BYTE, &size), "MPI_Get_count");
    Message message;
    message.from = status.MPI_SOURCE;
    message.tag = status.MPI_TAG;
    message.bytes.resize(static_cast<std::size_t>(size));
    check(MPI_Mrecv(message.bytes.data(), size, MPI_BYTE, &handle, MPI_STATUS_IGNORE), "MPI_Mrecv");
    return message;
  }

 private:
  struct Sending {
    std::string bytes;  // MPI reads from it until the request is complete
    MPI_Request request = MPI_REQUEST_NULL;
  };

  void forget_sent() {
    for (auto i = sending_.begin(); i != sending_.end();) {
      int done = 0;
      check(MPI_Test(&i->request, &done, MPI_STATUS_IGNORE), "MPI_Test");
      i = done != 0 ? sending_.erase(i) : std::next(i);
    }
  }

  MPI_Comm communicator_ = MPI_COMM_NULL;
  int rank_ = 0, size_ = 1;
  std::list<Sending> sending_;
};

}  // namespace

bool started_by_mpi() {
  // Open MPI's mpirun, the process managers of MPICH and others, and both interfaces of Slurm's srun.
  for (const char* name : {"OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "PMIX_RANK", "PMI_RANK"}) {
    if (std::getenv(name) != nullptr) return true;
  }
  return false;
}

MpiSession::MpiSession() {
  int provided = 0;
  check(MPI_Init_thread(nullptr, nullptr, MPI_THREAD_SERIALIZED, &provided), "MPI_Init_thread");
  if (provided < MPI_THREAD_SERIALIZED)
    throw Error("MPI: the library allows calls only from the main thread");
  transport_ = std::make_unique<MpiTransport>();
  char name[MPI_MAX_PROCESSOR_NAME];
  int length = 0;
  check(MPI_Get_processor_name(name, &length), "MPI_Get_processor_name");
  host_.assign(name, static_cast<std::size_t>(length));
}

MpiSession::~MpiSession() {
  transport_.reset();
  MPI_Finalize();
}

void MpiSession::abort(int status) {
  MPI_Abort(MPI_COMM_WORLD, status);
  std::abort();  // MPI_Abort() does not return, but its declaration does not say so
}

}  // namespace loopwise
