// Preloaded into the program, this makes one operation on files fail, or all from one on: CHAINSLAM_FAULT is
// OPERATION:PART:ERRNO:COUNT[:stay], the COUNT-th (from 0) of the operations on files whose path, which a $ ends, holds
// PART; with `stay` those after it fail as well, as on a full disk. OPERATION `any` is all of these. With errno 0, a
// write takes half of its bytes, and nothing else fails. With errno -1 the power fails at a sync: the file keeps what
// was synced before, and the program ends. CHAINSLAM_FAULT_LOG names a file that gets a line when the fault was met,
// CHAINSLAM_FAULT_COUNT one that gets the number of operations that could have met it.
// CHAINSLAM_MACHINE_PAGES is the memory that the machine seems to have, in pages; with CHAINSLAM_FILE_MEGABYTES, each
// file that is created costs so much memory for good.

#include <dlfcn.h>
#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <csignal>
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

void append_to(const char* log, const std::string& text) {
  if (log == nullptr) return;
  static const auto real_open = original<int (*)(const char*, int, ...)>("open");
  static const auto real_write = original<ssize_t (*)(int, const void*, size_t)>("write");
  const int file = real_open(log, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0666);
  if (file < 0) return;
  [[maybe_unused]] const ssize_t written = real_write(file, text.data(), text.size());
  ::close(file);
}

__attribute__((destructor)) void count_operations() {
  append_to(std::getenv("CHAINSLAM_FAULT_COUNT"), std::to_string(met) + "\n");
}

bool is_about(const Fault& wanted, std::string path) { return (path + '$').find(wanted.part) != std::string::npos; }

bool fails(const char* operation, const char* path) {
  const Fault* wanted = fault();
  if (wanted == nullptr || path == nullptr || (wanted->operation != operation && wanted->operation != "any"))
    return false;
  if (!is_about(*wanted, path)) return false;
  const long number = met.fetch_add(1);
  bool now = wanted->stays ? number >= wanted->count : number == wanted->count;
  now = now && (wanted->error != 0 || std::strcmp(operation, "write") == 0);
  if (now && wanted->error == -2) {
    ::sleep(10);
    return false;
  }
  if (now) {
    append_to(std::getenv("CHAINSLAM_FAULT_LOG"), std::string(operation) + ' ' + path + '\n');
    errno = wanted->error;
  }
  return now;
}

/// The path of an open file; empty if it has none.
std::string path_of(int file) {
  char link[64], path[4096];
  std::snprintf(link, sizeof link, "/proc/self/fd/%d", file);
  const ssize_t size = ::readlink(link, path, sizeof path - 1);
  return size < 0 ? std::string() : std::string(path, static_cast<std::size_t>(size));
}

bool fails(const char* operation, int file) {
  const Fault* wanted = fault();
  if (wanted == nullptr || (wanted->operation != operation && wanted->operation != "any")) return false;
  return fails(operation, path_of(file).c_str());
}

void cost_memory() {
  const char* const megabytes = std::getenv("CHAINSLAM_FILE_MEGABYTES");
  if (megabytes == nullptr) return;
  const std::size_t bytes = 1'000'000 * static_cast<std::size_t>(std::atol(megabytes));
  static void* volatile kept;  // or the compiler may leave out what nobody reads
  kept = std::malloc(bytes);
  if (kept != nullptr) std::memset(kept, 1, bytes);
}

/// Where the file that a fault is about ended when it was synced last.
std::atomic<off_t> synced_size{0};

/// @returns the sync's result, if the program goes on.
int synced(int file, int (*real)(int)) {
  const bool failed = fails("sync", file);
  if (failed && fault()->error == -1) {
    [[maybe_unused]] const int cut = ::ftruncate(file, synced_size);
    ::kill(::getpid(), SIGKILL);
  }
  if (failed) return -1;
  const int result = real(file);
  struct stat information {};
  if (fault() != nullptr && fault()->error == -1 && is_about(*fault(), path_of(file)) &&
      ::fstat(file, &information) == 0)
    synced_size = information.st_size;
  return result;
}

}  // namespace

extern "C" {

int open(const char* path, int flags, ...) {
  static const auto real = original<int (*)(const char*, int, ...)>("open");
  va_list arguments;
  va_start(arguments, flags);
  const mode_t mode = (flags & O_CREAT) != 0 ? va_arg(arguments, mode_t) : 0;
  va_end(arguments);
  if ((flags & O_CREAT) != 0) cost_memory();
  return fails((flags & O_CREAT) != 0 ? "create" : "open", path) ? -1 : real(path, flags, mode);
}

int open64(const char* path, int flags, ...) {
  static const auto real = original<int (*)(const char*, int, ...)>("open64");
  va_list arguments;
  va_start(arguments, flags);
  const mode_t mode = (flags & O_CREAT) != 0 ? va_arg(arguments, mode_t) : 0;
  va_end(arguments);
  if ((flags & O_CREAT) != 0) cost_memory();
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
  return synced(file, real);
}

int fdatasync(int file) {
  static const auto real = original<int (*)(int)>("fdatasync");
  return synced(file, real);
}

int rename(const char* from, const char* to) {
  static const auto real = original<int (*)(const char*, const char*)>("rename");
  return fails("rename", to) ? -1 : real(from, to);
}

int renameat2(int from_folder, const char* from, int to_folder, const char* to, unsigned flags) {
  static const auto real = original<int (*)(int, const char*, int, const char*, unsigned)>("renameat2");
  return fails("rename", to) ? -1 : real(from_folder, from, to_folder, to, flags);
}

int link(const char* from, const char* to) {
  static const auto real = original<int (*)(const char*, const char*)>("link");
  return fails("link", to) ? -1 : real(from, to);
}

int unlink(const char* path) {
  static const auto real = original<int (*)(const char*)>("unlink");
  return fails("remove", path) ? -1 : real(path);
}

long sysconf(int name) {
  static const auto real = original<long (*)(int)>("sysconf");
  const char* pages = std::getenv("CHAINSLAM_MACHINE_PAGES");
  return name == _SC_PHYS_PAGES && pages != nullptr ? std::atol(pages) : real(name);
}

int mkdir(const char* path, mode_t mode) {
  static const auto real = original<int (*)(const char*, mode_t)>("mkdir");
  return fails("mkdir", path) ? -1 : real(path, mode);
}
}
