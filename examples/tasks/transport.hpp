#pragma once

#include <cstdint>
#include <optional>

#include "chainslam/core/types.hpp"
#include "tasks/task_queue.hpp"

namespace chainslam::tasks {

/// What the processes of a job say to each other.
enum class MessageKind : std::int32_t {
  alive,     ///< either way, each second: the sender is there
  task,      ///< to a worker: do this
  stop,      ///< to a worker: end what you do, its result is not needed
  quit,      ///< to a worker: the job is done
  abandon,   ///< to a worker: likewise, but not all will end in order
  progress,  ///< from a worker: how far its task is
  result,    ///< from a worker: its task is done
  failure,   ///< from a worker: its task is not done, and why
  leave      ///< from a worker: it takes no more tasks, and what it had is not done
};

struct Message {
  MessageKind kind = MessageKind::alive;
  Index task = -1;  ///< number
  Bytes bytes{};
};

struct ReceivedMessage {
  int from = 0;
  Message message;
};

/// Carries messages between the processes of a job, of which 0 gives the tasks. For one thread at a time.
class Transport {
 public:
  Transport() = default;
  Transport(const Transport&) = delete;
  Transport& operator=(const Transport&) = delete;
  virtual ~Transport() = default;

  [[nodiscard]] virtual int size() const = 0;
  /// Does not wait for the receiver, which may be dead.
  virtual void send(int to, const Message& message) = 0;
  /// Does not wait for a message; those of one sender come in their order.
  [[nodiscard]] virtual std::optional<ReceivedMessage> receive() = 0;
};

}  // namespace chainslam::tasks
