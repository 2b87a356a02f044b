// Preloaded into the program, this makes one operation on files fail, or all from one on: CHAINSLAM_FAULT is
// OPERATION:PART:ERRNO:COUNT[:stay], the COUNT-th (from 0) of the operations on files whose path holds PART; with
// `stay` those after it fail as well, as on a full disk. With errno 0, a write takes half of its bytes.
// CHAINSLAM_FAULT_LOG names a file that gets a line when the fault was met.

#include <dlfcn.h>
#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstdarg>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>

namespace {

struct Fault {
  std::string operation, part;
  int error = 0;
  long count = 0;
  bool stays = false;
};

const Fault* fault() {
  static const Fault* const parsed = []() -> const Fault* {
    const char* text = std::getenv("CHAINSLAM_FAULT");
    if (text == nullptr) return nullptr;
    char operation[32] = "", part[128] = "", stay[8] = "";
    auto* result = new Fault;
    if (std::sscanf(text, "%31[^:]:%127[^:]:%d:%ld:%7s", operation, part, &result->error, &result->count, stay) < 4)
      return nullptr;
    result->operation = operation;
    result->part = part;
    result->stays = std::strcmp(stay, "stay") == 0;
    return result;
  }();
  return parsed;
}

std::atomic<long> met{0};

template <class Function>
Function original(const char* name) {
  return reinterpret_cast<Function>(::dlsym(RTLD_NEXT, name));
}

void log_fault() {
  const char* log = std::getenv("CHAINSLAM_FAULT_LOG");
  if (log == nullptr) return;
  static const auto real_open = original<int (*)(const char*, int, ...)>("open");
  static const auto real_write = original<ssize_t (*)(int, const void*, size_t)>("write");
  const int file = real_open(log, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0666);
  if (file < 0) return;
  [[maybe_unused]] const ssize_t written = real_write(file, "met\n", 4);
  ::close(file);
}

bool fails(const char* operation, const char* path) {
  const Fault* wanted = fault();
  if (wanted == nullptr || path == nullptr || wanted->operation != operation) return false;
  if (std::strstr(path, wanted->part.c_str()) == nullptr) return false;
  const long number = met.fetch_add(1);
  const bool now = wanted->stays ? number >= wanted->count : number == wanted->count;
  if (now) {
    log_fault();
    errno = wanted->error;
  }
  return now;
}

bool fails(const char* operation, int file) {
  const Fault* wanted = fault();
  if (wanted == nullptr || wanted->operation != operation) return false;
  char link[64], path[4096];
  std::snprintf(link, sizeof link, "/proc/self/fd/%d", file);
  const ssize_t size = ::readlink(link, path, sizeof path - 1);
  if (size < 0) return false;
  path[size] = '\0';
  return fails(operation, path);
}

}  // namespace

extern "C" {

int open(const char* path, int flags, ...) {
  static const auto real = original<int (*)(const char*, int, ...)>("open");
  va_list arguments;
  va_start(arguments, flags);
  const mode_t mode = (flags & O_CREAT) != 0 ? va_arg(arguments, mode_t) : 0;
  va_end(arguments);
  return fails((flags & O_CREAT) != 0 ? "create" : "open", path) ? -1 : real(path, flags, mode);
}

int open64(const char* path, int flags, ...) {
  static const auto real = original<int (*)(const char*, int, ...)>("open64");
  va_list arguments;
  va_start(arguments, flags);
  const mode_t mode = (flags & O_CREAT) != 0 ? va_arg(arguments, mode_t) : 0;
  va_end(arguments);
  return fails((flags & O_CREAT) != 0 ? "create" : "open", path) ? -1 : real(path, flags, mode);
}

ssize_t write(int file, const void* data, size_t size) {
  static const auto real = original<ssize_t (*)(int, const void*, size_t)>("write");
  if (!fails("write", file)) return real(file, data, size);
  return fault()->error == 0 ? real(file, data, (size + 1) / 2) : -1;
}

ssize_t read(int file, void* data, size_t size) {
  static const auto real = original<ssize_t (*)(int, void*, size_t)>("read");
  return fails("read", file) ? -1 : real(file, data, size);
}

ssize_t pread(int file, void* data, size_t size, off_t offset) {
  static const auto real = original<ssize_t (*)(int, void*, size_t, off_t)>("pread");
  return fails("read", file) ? -1 : real(file, data, size, offset);
}

ssize_t pread64(int file, void* data, size_t size, off64_t offset) {
  static const auto real = original<ssize_t (*)(int, void*, size_t, off64_t)>("pread64");
  return fails("read", file) ? -1 : real(file, data, size, offset);
}

int fsync(int file) {
  static const auto real = original<int (*)(int)>("fsync");
  return fails("sync", file) ? -1 : real(file);
}

int fdatasync(int file) {
  static const auto real = original<int (*)(int)>("fdatasync");
  return fails("sync", file) ? -1 : real(file);
}

int rename(const char* from, const char* to) {
  static const auto real = original<int (*)(const char*, const char*)>("rename");
  return fails("rename", to) ? -1 : real(from, to);
}

int renameat2(int from_folder, const char* from, int to_folder, const char* to, unsigned flags) {
  static const auto real = original<int (*)(int, const char*, int, const char*, unsigned)>("renameat2");
  return fails("rename", to) ? -1 : real(from_folder, from, to_folder, to, flags);
}

int mkdir(const char* path, mode_t mode) {
  static const auto real = original<int (*)(const char*, mode_t)>("mkdir");
  return fails("mkdir", path) ? -1 : real(path, mode);
}
}
