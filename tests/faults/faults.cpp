// SPDX-License-Identifier: BSD-3-Clause
/// \file
/// A library to preload (LD_PRELOAD) that makes the n-th system call of a kind, or the n-th allocation, fail.
/// It counts calls on files below a folder alone, and allocations, from the start of main() to its end.
///
///     LOOPWISE_FAULT         what fails, as CLASS:HOW, for example write:ENOSPC, read:short, alloc:once
///     LOOPWISE_FAULT_AT      which call of that class, from 1; 0 only counts, and logs "wrote FILE",
///                            "flushed FILE", "flushed *" and "moved FROM TO"
///     LOOPWISE_FAULT_FOLDER  absolute folders, separated by colons
///     LOOPWISE_FAULT_LOG     file that gets one line with the fault, and at the end the counts
///     LOOPWISE_FAULT_SERVER  IN,OUT: two descriptors, see serve()
///
/// Classes: open, read, write, sync, close, rename, mkdir, unlink, opendir, mmap, stat, lock, alloc. HOW: the
/// name of an error; `short` (half of the bytes); `once`, of allocations; with a `+` behind it this call and
/// all after it. Of the close class the file is closed all the same, as the system does it.
#include <dirent.h>
#include <dlfcn.h>
#include <fcntl.h>
#include <sys/file.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <cerrno>
#include <cstdarg>
#include <cstddef>
#include <cstdio>
#include <cstdlib>
#include <cstring>

extern "C" {
// The allocator under its own names: what dlsym() finds may allocate itself.
void* __libc_malloc(std::size_t size);
void* __libc_calloc(std::size_t count, std::size_t size);
void* __libc_realloc(void* block, std::size_t size);
void* __libc_memalign(std::size_t alignment, std::size_t size);
}

namespace {

enum Class {
  kOpen,
  kRead,
  kWrite,
  kSync,
  kClose,
  kRename,
  kMkdir,
  kUnlink,
  kOpendir,
  kMmap,
  kStat,
  kLock,
  kAlloc,
  kClasses
};
constexpr std::array<const char*, kClasses> kNames{"open",   "read",  "write",  "sync",    "close",
                                                   "rename", "mkdir", "unlink", "opendir", "mmap",
                                                   "stat",   "lock",  "alloc"};

struct Error {
  const char* name;
  int number;
};
constexpr std::array<Error, 9> kErrors{{{"ENOSPC", ENOSPC},
                                        {"EIO", EIO},
                                        {"EACCES", EACCES},
                                        {"EMFILE", EMFILE},
                                        {"ENOMEM", ENOMEM},
                                        {"EDQUOT", EDQUOT},
                                        {"EROFS", EROFS},
                                        {"ENOLCK", ENOLCK},
                                        {"EINTR", EINTR}}};

constexpr std::size_t kPathBytes = 512;
constexpr int kMostFiles = 1024;

// Plain data alone: this code runs before and after all constructors, and within malloc().
std::atomic<bool> armed{false};
std::array<std::atomic<unsigned long>, kClasses> calls{};
Class wanted = kClasses;
unsigned long wanted_at = 0;
int error_number = 0;
bool is_short = false;
bool goes_on = false;
const char* folders = nullptr;
const char* log_path = nullptr;
std::array<std::array<char, kPathBytes>, kMostFiles> paths{};  // by descriptor; empty: not watched
std::array<std::atomic<bool>, kMostFiles> written{};           // by descriptor: since the last flush

/// Straight to the kernel, so that nothing of this is counted.
void log_line(const char* a, const char* b, const char* c) {
  if (log_path == nullptr) return;
  const long fd = syscall(SYS_openat, AT_FDCWD, log_path, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0666);
  if (fd < 0) return;
  for (const char* text : {a, " ", b, " ", c, "\n"}) {
    static_cast<void>(syscall(SYS_write, fd, text, std::strlen(text)));
  }
  static_cast<void>(syscall(SYS_close, fd));
}

/// How a call shall end.
enum class Fate { kWell, kFails, kShort };

Fate fate_of(Class kind, const char* path) {
  if (!armed.load(std::memory_order_relaxed)) return Fate::kWell;
  const unsigned long number = calls[kind].fetch_add(1, std::memory_order_relaxed) + 1;
  if (kind != wanted || wanted_at == 0) return Fate::kWell;
  if (number == wanted_at) {
    const int kept = errno;
    log_line("fault", kNames[kind], path);
    errno = kept;
  }
  if (number != wanted_at && !(goes_on && number > wanted_at)) return Fate::kWell;
  if (is_short) return Fate::kShort;
  errno = error_number;
  return Fate::kFails;
}

/// The absolute path without a look at the disk; false if it is too long.
bool absolute(const char* path, char* out) {
  std::size_t used = 0;
  if (path[0] != '/') {
    if (getcwd(out, kPathBytes) == nullptr) return false;
    used = std::strlen(out);
    if (used + 1 >= kPathBytes) return false;
    out[used++] = '/';
  }
  const std::size_t size = std::strlen(path);
  if (used + size >= kPathBytes) return false;
  std::memcpy(out + used, path, size + 1);
  return true;
}

bool watched(const char* path, char* whole) {
  if (path == nullptr || folders == nullptr || !armed.load(std::memory_order_relaxed)) return false;
  if (!absolute(path, whole)) return false;
  for (const char* folder = folders; *folder != '\0';) {
    const char* end = std::strchr(folder, ':');
    const std::size_t size = end != nullptr ? static_cast<std::size_t>(end - folder) : std::strlen(folder);
    const char after = std::strncmp(whole, folder, size) == 0 ? whole[size] : 'x';
    if (size > 0 && (after == '/' || after == '\0')) return true;
    folder += size + (end != nullptr ? 1 : 0);
  }
  return false;
}

const char* path_of(int fd) {
  if (fd < 0 || fd >= kMostFiles || paths[static_cast<std::size_t>(fd)][0] == '\0') return nullptr;
  return paths[static_cast<std::size_t>(fd)].data();
}

void watch(int fd, const char* whole) {
  if (fd < 0 || fd >= kMostFiles) return;
  auto& path = paths[static_cast<std::size_t>(fd)];
  std::snprintf(path.data(), path.size(), "%s", whole);
}

void forget(int fd) {
  if (fd < 0 || fd >= kMostFiles) return;
  paths[static_cast<std::size_t>(fd)][0] = '\0';
  written[static_cast<std::size_t>(fd)] = false;
}

bool counts_only() {
  return wanted_at == 0 && armed.load(std::memory_order_relaxed);
}

/// Logs each file once until it is flushed, because programs write in pieces.
void note_write(int fd, const char* path) {
  if (counts_only() && !written[static_cast<std::size_t>(fd)].exchange(true)) log_line("wrote", path, "");
}

/// \param path "*" if all files are flushed
int note_flush(int fd, const char* path, int result) {
  if (path == nullptr || result != 0 || !counts_only()) return result;
  written[static_cast<std::size_t>(fd)] = false;
  if (*path == '*') {
    for (auto& file : written) file = false;
  }
  log_line("flushed", path, "");
  return result;
}

/// The function that this library replaces.
template <class Function>
Function* next(std::atomic<void*>& known, const char* name) {
  void* found = known.load(std::memory_order_acquire);
  if (found == nullptr) {
    found = dlsym(RTLD_NEXT, name);
    known.store(found, std::memory_order_release);
  }
  return reinterpret_cast<Function*>(found);
}
#define NEXT(name)                               \
  ([]() {                                        \
    static std::atomic<void*> known{nullptr};    \
    return next<decltype(::name)>(known, #name); \
  }())

std::size_t half(std::size_t size) {
  return size > 1 ? size / 2 : size;
}

void configure() {
  folders = std::getenv("LOOPWISE_FAULT_FOLDER");
  log_path = std::getenv("LOOPWISE_FAULT_LOG");
  const char* at = std::getenv("LOOPWISE_FAULT_AT");
  const char* fault = std::getenv("LOOPWISE_FAULT");
  if (at == nullptr || fault == nullptr) return;
  wanted_at = std::strtoul(at, nullptr, 10);
  const char* colon = std::strchr(fault, ':');
  if (colon == nullptr) return;
  for (int k = 0; k < kClasses; ++k) {
    const char* name = kNames[static_cast<std::size_t>(k)];
    if (std::strlen(name) == static_cast<std::size_t>(colon - fault) &&
        std::strncmp(fault, name, std::strlen(name)) == 0) {
      wanted = static_cast<Class>(k);
    }
  }
  std::size_t size = std::strlen(colon + 1);
  goes_on = size > 0 && colon[size] == '+';
  if (goes_on) --size;
  is_short = size == 5 && std::strncmp(colon + 1, "short", size) == 0;
  error_number = wanted == kAlloc ? ENOMEM : EIO;
  for (const Error& error : kErrors) {
    if (std::strlen(error.name) == size && std::strncmp(colon + 1, error.name, size) == 0)
      error_number = error.number;
  }
}

void write_counts() {
  armed = false;
  for (int k = 0; k < kClasses; ++k) {
    char number[24];
    std::snprintf(number, sizeof number, "%lu", calls[static_cast<std::size_t>(k)].load());
    log_line("calls", kNames[static_cast<std::size_t>(k)], number);
  }
}

using Main = int (*)(int, char**, char**);
Main program_main = nullptr;

int run_counted(int argc, char** argv, char** environment) {
  configure();
  armed = true;
  const int status = program_main(argc, argv, environment);
  write_counts();
  return status;
}

constexpr std::size_t kLineBytes = 2 * kPathBytes;

/// A line without its end; false at the end of what comes.
bool read_line(int from, char* line) {
  for (std::size_t used = 0; used < kLineBytes; ++used) {
    if (syscall(SYS_read, from, line + used, 1) != 1) return false;
    if (line[used] == '\n') {
      line[used] = '\0';
      return true;
    }
  }
  return false;
}

void write_number(int to, int number) {
  char text[24];
  const int size = std::snprintf(text, sizeof text, "%d\n", number);
  static_cast<void>(syscall(SYS_write, to, text, static_cast<std::size_t>(size)));
}

void open_as(int wanted_fd, const char* path, int flags) {
  const long fd = syscall(SYS_openat, AT_FDCWD, path, flags, 0666);
  if (fd < 0 || dup2(static_cast<int>(fd), wanted_fd) < 0) _exit(125);
  syscall(SYS_close, fd);
}

/// Linking the program takes longer than most of its runs, so it is linked once and every run is a fork of
/// it. A line of IN asks for a run: FAULT, AT and FOLDER, by tabs. It runs in FOLDER, its standard error goes
/// to FOLDER/err and its log to FOLDER/fault.log; OUT gets a line with its number, and, when it has ended,
/// one with its status as waitpid() gives it. True in the forks; false in what serves, at the end of IN.
bool serve(const char* descriptors) {
  const int in = std::atoi(descriptors);
  const char* comma = std::strchr(descriptors, ',');
  if (comma == nullptr) return false;
  const int out = std::atoi(comma + 1);
  static char line[kLineBytes];
  while (read_line(in, line)) {
    char* at = std::strchr(line, '\t');
    char* folder = at != nullptr ? std::strchr(at + 1, '\t') : nullptr;
    if (folder == nullptr) return false;
    *at++ = '\0';
    *folder++ = '\0';
    const pid_t child = fork();
    if (child < 0) return false;
    if (child == 0) {
      if (chdir(folder) != 0) _exit(125);
      open_as(0, "/dev/null", O_RDONLY);
      open_as(1, "/dev/null", O_WRONLY);
      open_as(2, "err", O_WRONLY | O_CREAT | O_TRUNC);
      syscall(SYS_close, in);
      syscall(SYS_close, out);
      static char log[kLineBytes + 16];
      std::snprintf(log, sizeof log, "%s/fault.log", folder);
      setenv("LOOPWISE_FAULT", line, 1);
      setenv("LOOPWISE_FAULT_AT", at, 1);
      setenv("LOOPWISE_FAULT_LOG", log, 1);
      return true;
    }
    write_number(out, child);
    int status = 0;
    while (waitpid(child, &status, 0) < 0 && errno == EINTR) {
    }
    write_number(out, status);
  }
  return false;
}

int counted_main(int argc, char** argv, char** environment) {
  if (const char* descriptors = std::getenv("LOOPWISE_FAULT_SERVER")) {
    if (!serve(descriptors)) return 0;
  }
  return run_counted(argc, argv, environment);
}

}  // namespace

extern "C" {

int __libc_start_main(Main main_function, int argc, char** argv, void (*init)(), void (*fini)(),
                      void (*rtld_fini)(), void* stack_end) {
  using Start = int(Main, int, char**, void (*)(), void (*)(), void (*)(), void*);
  program_main = main_function;
  auto* start = reinterpret_cast<Start*>(dlsym(RTLD_NEXT, "__libc_start_main"));
  return start(counted_main, argc, argv, init, fini, rtld_fini, stack_end);
}

// ---- allocations

void* malloc(std::size_t size) {
  return fate_of(kAlloc, "malloc") == Fate::kWell ? __libc_malloc(size) : nullptr;
}
void* calloc(std::size_t count, std::size_t size) {
  return fate_of(kAlloc, "calloc") == Fate::kWell ? __libc_calloc(count, size) : nullptr;
}
void* realloc(void* block, std::size_t size) {
  return fate_of(kAlloc, "realloc") == Fate::kWell ? __libc_realloc(block, size) : nullptr;
}
void* memalign(std::size_t alignment, std::size_t size) {
  return fate_of(kAlloc, "memalign") == Fate::kWell ? __libc_memalign(alignment, size) : nullptr;
}
void* aligned_alloc(std::size_t alignment, std::size_t size) {
  return fate_of(kAlloc, "aligned_alloc") == Fate::kWell ? __libc_memalign(alignment, size) : nullptr;
}
int posix_memalign(void** block, std::size_t alignment, std::size_t size) {
  if (fate_of(kAlloc, "posix_memalign") != Fate::kWell) return ENOMEM;
  void* made = __libc_memalign(alignment, size);
  if (made == nullptr) return ENOMEM;
  *block = made;
  return 0;
}

// ---- files

// Calls that make files have the mode of the file as one argument more.
#define MODE_OF(flags)                             \
  mode_t mode = 0;                                 \
  if (((flags) & (O_CREAT | O_TMPFILE)) != 0) {    \
    va_list rest;                                  \
    va_start(rest, flags);                         \
    mode = static_cast<mode_t>(va_arg(rest, int)); \
    va_end(rest);                                  \
  }

#define OPEN(name)                                                \
  int name(const char* path, int flags, ...) {                    \
    MODE_OF(flags)                                                \
    char whole[kPathBytes];                                       \
    const bool seen = watched(path, whole);                       \
    if (seen && fate_of(kOpen, whole) == Fate::kFails) return -1; \
    const int fd = NEXT(name)(path, flags, mode);                 \
    if (seen) watch(fd, whole);                                   \
    return fd;                                                    \
  }
OPEN(open)
OPEN(open64)

// Relative to another folder than the current one: libstdc++'s walk through folders. Watched by that folder's
// path.
#define OPENAT(name)                                                      \
  int name(int folder, const char* path, int flags, ...) {                \
    MODE_OF(flags)                                                        \
    char whole[kPathBytes];                                               \
    bool seen = folder == AT_FDCWD && watched(path, whole);               \
    if (folder != AT_FDCWD && path_of(folder) != nullptr) {               \
      seen = true;                                                        \
      std::snprintf(whole, sizeof whole, "%s/%s", path_of(folder), path); \
    }                                                                     \
    if (seen && fate_of(kOpen, whole) == Fate::kFails) return -1;         \
    const int fd = NEXT(name)(folder, path, flags, mode);                 \
    if (seen) watch(fd, whole);                                           \
    return fd;                                                            \
  }
#pragma GCC diagnostic ignored "-Wformat-truncation"
OPENAT(openat)
OPENAT(openat64)

#define FOPEN(name)                                                    \
  FILE* name(const char* path, const char* mode) {                     \
    char whole[kPathBytes];                                            \
    const bool seen = watched(path, whole);                            \
    if (seen && fate_of(kOpen, whole) == Fate::kFails) return nullptr; \
    FILE* file = NEXT(name)(path, mode);                               \
    if (seen && file != nullptr) watch(fileno(file), whole);           \
    return file;                                                       \
  }
FOPEN(fopen)
FOPEN(fopen64)

int flock(int fd, int operation) {
  const char* path = path_of(fd);
  if (path != nullptr && fate_of(kLock, path) == Fate::kFails) return -1;
  return NEXT(flock)(fd, operation);
}

ssize_t read(int fd, void* out, std::size_t size) {
  if (const char* path = path_of(fd)) {
    const Fate fate = fate_of(kRead, path);
    if (fate == Fate::kFails) return -1;
    if (fate == Fate::kShort) size = half(size);
  }
  return NEXT(read)(fd, out, size);
}
ssize_t pread(int fd, void* out, std::size_t size, off_t offset) {
  if (const char* path = path_of(fd)) {
    const Fate fate = fate_of(kRead, path);
    if (fate == Fate::kFails) return -1;
    if (fate == Fate::kShort) size = half(size);
  }
  return NEXT(pread)(fd, out, size, offset);
}
ssize_t pread64(int fd, void* out, std::size_t size, off64_t offset) {
  if (const char* path = path_of(fd)) {
    const Fate fate = fate_of(kRead, path);
    if (fate == Fate::kFails) return -1;
    if (fate == Fate::kShort) size = half(size);
  }
  return NEXT(pread64)(fd, out, size, offset);
}
std::size_t fread(void* out, std::size_t size, std::size_t count, FILE* file) {
  if (const char* path = path_of(fileno(file))) {
    // A short read of a stream is the end of the file or an error, so there is one kind.
    if (fate_of(kRead, path) != Fate::kWell) return 0;
  }
  return NEXT(fread)(out, size, count, file);
}

ssize_t write(int fd, const void* bytes, std::size_t size) {
  if (const char* path = path_of(fd)) {
    const Fate fate = fate_of(kWrite, path);
    if (fate == Fate::kFails) return -1;
    note_write(fd, path);
    if (fate == Fate::kShort) size = half(size);
  }
  return NEXT(write)(fd, bytes, size);
}
ssize_t pwrite(int fd, const void* bytes, std::size_t size, off_t offset) {
  if (const char* path = path_of(fd)) {
    const Fate fate = fate_of(kWrite, path);
    if (fate == Fate::kFails) return -1;
    note_write(fd, path);
    if (fate == Fate::kShort) size = half(size);
  }
  return NEXT(pwrite)(fd, bytes, size, offset);
}
ssize_t writev(int fd, const struct iovec* parts, int count) {
  if (const char* path = path_of(fd)) {
    const Fate fate = fate_of(kWrite, path);
    if (fate == Fate::kFails) return -1;
    note_write(fd, path);
    if (fate == Fate::kShort && count > 0) return NEXT(write)(fd, parts[0].iov_base, half(parts[0].iov_len));
  }
  return NEXT(writev)(fd, parts, count);
}
std::size_t fwrite(const void* bytes, std::size_t size, std::size_t count, FILE* file) {
  if (const char* path = path_of(fileno(file))) {
    const Fate fate = fate_of(kWrite, path);
    if (fate == Fate::kFails) return 0;
    note_write(fileno(file), path);
    if (fate == Fate::kShort) count = half(count);
  }
  return NEXT(fwrite)(bytes, size, count, file);
}

int fsync(int fd) {
  const char* path = path_of(fd);
  if (path != nullptr && fate_of(kSync, path) != Fate::kWell) return -1;
  return note_flush(fd, path, NEXT(fsync)(fd));
}
int fdatasync(int fd) {
  const char* path = path_of(fd);
  if (path != nullptr && fate_of(kSync, path) != Fate::kWell) return -1;
  return note_flush(fd, path, NEXT(fdatasync)(fd));
}
int syncfs(int fd) {
  const char* path = path_of(fd);
  if (path != nullptr && fate_of(kSync, path) != Fate::kWell) return -1;
  return note_flush(fd, path != nullptr ? "*" : nullptr, NEXT(syncfs)(fd));
}
int close(int fd) {
  const char* path = path_of(fd);
  const bool fails = path != nullptr && fate_of(kClose, path) == Fate::kFails;
  forget(fd);
  const int result = NEXT(close)(fd);
  if (!fails) return result;
  errno = error_number;
  return -1;
}
int fclose(FILE* file) {
  const int fd = fileno(file);
  const char* path = path_of(fd);
  const bool fails = path != nullptr && fate_of(kClose, path) == Fate::kFails;
  forget(fd);
  const int result = NEXT(fclose)(file);
  if (!fails) return result;
  errno = error_number;
  return EOF;
}

int rename(const char* from, const char* to) {
  char whole[kPathBytes];
  if (!watched(to, whole)) return NEXT(rename)(from, to);
  if (fate_of(kRename, whole) != Fate::kWell) return -1;
  char before[kPathBytes];
  const int result = NEXT(rename)(from, to);
  if (result == 0 && counts_only() && absolute(from, before)) log_line("moved", before, whole);
  return result;
}
int mkdir(const char* path, mode_t mode) {
  char whole[kPathBytes];
  return watched(path, whole) && fate_of(kMkdir, whole) != Fate::kWell ? -1 : NEXT(mkdir)(path, mode);
}
int unlink(const char* path) {
  char whole[kPathBytes];
  return watched(path, whole) && fate_of(kUnlink, whole) != Fate::kWell ? -1 : NEXT(unlink)(path);
}
int rmdir(const char* path) {
  char whole[kPathBytes];
  return watched(path, whole) && fate_of(kUnlink, whole) != Fate::kWell ? -1 : NEXT(rmdir)(path);
}
int remove(const char* path) {
  char whole[kPathBytes];
  return watched(path, whole) && fate_of(kUnlink, whole) != Fate::kWell ? -1 : NEXT(remove)(path);
}
int unlinkat(int folder, const char* path, int flags) {
  const char* in = path_of(folder);
  char whole[kPathBytes];
  const bool seen = in != nullptr || (folder == AT_FDCWD && watched(path, whole));
  return seen && fate_of(kUnlink, path) != Fate::kWell ? -1 : NEXT(unlinkat)(folder, path, flags);
}
DIR* opendir(const char* path) {
  char whole[kPathBytes];
  if (!watched(path, whole)) return NEXT(opendir)(path);
  if (fate_of(kOpendir, whole) != Fate::kWell) return nullptr;
  DIR* folder = NEXT(opendir)(path);
  if (folder != nullptr) watch(dirfd(folder), whole);
  return folder;
}
int closedir(DIR* folder) {
  forget(dirfd(folder));
  return NEXT(closedir)(folder);
}

void* mmap(void* at, std::size_t size, int protection, int flags, int fd, off_t offset) {
  const char* path = path_of(fd);
  if (path != nullptr && fate_of(kMmap, path) != Fate::kWell) return MAP_FAILED;
  return reinterpret_cast<void*>(syscall(SYS_mmap, at, size, protection, flags, fd, offset));
}
void* mmap64(void* at, std::size_t size, int protection, int flags, int fd, off64_t offset) {
  const char* path = path_of(fd);
  if (path != nullptr && fate_of(kMmap, path) != Fate::kWell) return MAP_FAILED;
  return reinterpret_cast<void*>(syscall(SYS_mmap, at, size, protection, flags, fd, offset));
}

#define STAT(name, type)                                                         \
  int name(const char* path, struct type* out) {                                 \
    char whole[kPathBytes];                                                      \
    if (watched(path, whole) && fate_of(kStat, whole) != Fate::kWell) return -1; \
    return NEXT(name)(path, out);                                                \
  }
#define FSTAT(name, type)                                                  \
  int name(int fd, struct type* out) {                                     \
    const char* path = path_of(fd);                                        \
    if (path != nullptr && fate_of(kStat, path) != Fate::kWell) return -1; \
    return NEXT(name)(fd, out);                                            \
  }
STAT(stat, stat)
STAT(stat64, stat64)
STAT(lstat, stat)
STAT(lstat64, stat64)
FSTAT(fstat, stat)
FSTAT(fstat64, stat64)

}  // extern "C"
