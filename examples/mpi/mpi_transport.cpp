#include "mpi_transport.hpp"

#include <array>
#include <chrono>
#include <cstring>
#include <stdexcept>
#include <string>
#include <thread>

namespace chainslam::mpi {

namespace {

constexpr int tag = 1;

struct Head {
  tasks::MessageKind kind;
  Index task;
};

void check(int error, const char* doing) {
  if (error == MPI_SUCCESS) return;
  std::array<char, MPI_MAX_ERROR_STRING> text{};
  int length = 0;
  MPI_Error_string(error, text.data(), &length);
  throw std::runtime_error(std::string("MPI, ") + doing + ": " + text.data());
}

}  // namespace

Environment::Environment(int& argc, char**& argv) {
  int provided = 0;
  MPI_Init_thread(&argc, &argv, MPI_THREAD_SERIALIZED, &provided);
  if (provided < MPI_THREAD_SERIALIZED) throw std::runtime_error("this MPI was built without threads");
  MPI_Comm_set_errhandler(MPI_COMM_WORLD, MPI_ERRORS_RETURN);
  MPI_Comm_rank(MPI_COMM_WORLD, &rank_);
  MPI_Comm_size(MPI_COMM_WORLD, &size_);
  MPI_Comm here = MPI_COMM_NULL;
  check(MPI_Comm_split_type(MPI_COMM_WORLD, MPI_COMM_TYPE_SHARED, rank_, MPI_INFO_NULL, &here), "asking for machines");
  MPI_Comm_size(here, &size_here_);
  MPI_Comm_free(&here);
}

Environment::~Environment() { MPI_Finalize(); }

MpiTransport::~MpiTransport() {
  const auto patience = std::chrono::steady_clock::now() + std::chrono::seconds(1);
  for (forget_sent(); !sending_.empty() && std::chrono::steady_clock::now() < patience; forget_sent())
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  // The buffers of what a dead process will never take must outlive MPI.
  if (!sending_.empty()) static_cast<void>(new std::list<Sending>(std::move(sending_)));
}

void MpiTransport::send(int to, const tasks::Message& message) {
  forget_sent();
  Sending& sending = sending_.emplace_back();
  const Head head{message.kind, message.task};
  sending.bytes.resize(sizeof head + message.bytes.size());
  std::memcpy(sending.bytes.data(), &head, sizeof head);
  std::memcpy(sending.bytes.data() + sizeof head, message.bytes.data(), message.bytes.size());
  // Of a process that is not there any more, others hear by its silence.
  MPI_Isend(sending.bytes.data(), to_index(sending.bytes.size()), MPI_BYTE, to, tag, MPI_COMM_WORLD, &sending.request);
}

void MpiTransport::forget_sent() {
  sending_.remove_if([](Sending& sending) {
    int sent = 0;
    return MPI_Test(&sending.request, &sent, MPI_STATUS_IGNORE) != MPI_SUCCESS || sent != 0;
  });
}

std::optional<tasks::ReceivedMessage> MpiTransport::receive() {
  int found = 0;
  MPI_Status status;
  if (MPI_Iprobe(MPI_ANY_SOURCE, tag, MPI_COMM_WORLD, &found, &status) != MPI_SUCCESS || found == 0)
    return std::nullopt;
  int size = 0;
  MPI_Get_count(&status, MPI_BYTE, &size);
  std::vector<char> bytes(static_cast<std::size_t>(size));
  check(MPI_Recv(bytes.data(), size, MPI_BYTE, status.MPI_SOURCE, tag, MPI_COMM_WORLD, MPI_STATUS_IGNORE), "receiving");
  Head head{};
  if (bytes.size() < sizeof head) throw std::runtime_error("MPI: a message of another program");
  std::memcpy(&head, bytes.data(), sizeof head);
  return tasks::ReceivedMessage{status.MPI_SOURCE,
                                {head.kind, head.task, std::string(bytes.begin() + sizeof head, bytes.end())}};
}

}  // namespace chainslam::mpi
