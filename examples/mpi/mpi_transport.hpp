#pragma once

#include <mpi.h>

#include <list>
#include <optional>
#include <vector>

#include "tasks/transport.hpp"

namespace chainslam::mpi {

/// MPI while it lives. Made by `main`'s thread; afterwards a thread at a time may call MPI.
class Environment {
 public:
  Environment(int& argc, char**& argv);
  Environment(const Environment&) = delete;
  Environment& operator=(const Environment&) = delete;
  /// Waits for the other processes, which end as well.
  ~Environment();

  [[nodiscard]] int rank() const { return rank_; }
  [[nodiscard]] int size() const { return size_; }
  /// How many of the processes are on this machine.
  [[nodiscard]] int size_here() const { return size_here_; }

 private:
  int rank_ = 0, size_ = 1, size_here_ = 1;
};

/// Messages between the processes of an MPI job. No call waits for another process, which may be dead.
class MpiTransport final : public tasks::Transport {
 public:
  explicit MpiTransport(const Environment& environment) : size_(environment.size()) {}
  /// What no process has received yet gets a second; then it is left.
  ~MpiTransport() override;

  [[nodiscard]] int size() const override { return size_; }
  void send(int to, const tasks::Message& message) override;
  [[nodiscard]] std::optional<tasks::ReceivedMessage> receive() override;

 private:
  struct Sending {
    std::vector<char> bytes;
    MPI_Request request = MPI_REQUEST_NULL;
  };
  void forget_sent();

  int size_;
  std::list<Sending> sending_;
};

}  // namespace chainslam::mpi
