/* Lets calls that change files fail, below one folder, as a full or broken disk would, or ends the process there.
 *
 * Preloaded (LD_PRELOAD). What is to fail is said in a file that all processes of a run map, LINKSIDE_FAULTS, so that
 * calls are counted over all of them; `faults.py` writes it. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <signal.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>

enum call { OPEN, WRITE, SYNC, RENAME, CALLS };
enum way { ERRNO, FULL, SHORT, KILL };

/* The `Plan` of faults.py. */
struct plan {
    int32_t call;  /* which kind of call, or -1: none, only count */
    int32_t way;
    int32_t error; /* errno, where the way is ERRNO */
    int32_t unused;
    int64_t at;    /* which call of that kind, from 1 */
    _Atomic int64_t seen[CALLS];
    char folder[PATH_MAX];
};

static struct plan *plan;

__attribute__((constructor)) static void load(void) {
    const char *path = getenv("LINKSIDE_FAULTS");
    int file = path ? open(path, O_RDWR) : -1;
    if (file < 0) return;
    void *mapped = mmap(NULL, sizeof(struct plan), PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    close(file);
    if (mapped != MAP_FAILED) plan = mapped;
}

static int below(const char *path) {
    size_t length = strlen(plan->folder);
    return length && strncmp(path, plan->folder, length) == 0;
}

static int file_is_below(int file) {
    char link[64], path[PATH_MAX];
    snprintf(link, sizeof link, "/proc/self/fd/%d", file);
    ssize_t length = readlink(link, path, sizeof path - 1);
    if (length < 0) return 0;
    path[length] = 0;
    return below(path);
}

static int path_is_below(const char *path) {
    char whole[2 * PATH_MAX], folder[PATH_MAX];
    if (path[0] == '/') return below(path);
    if (!getcwd(folder, sizeof folder)) return 0;
    snprintf(whole, sizeof whole, "%s/%s", folder, path);
    return below(whole);
}

/* Whether this call is the one that is to fail; a disk that is full stays full. */
static int is_meant(enum call call) {
    int64_t number = 1 + atomic_fetch_add(&plan->seen[call], 1);
    if (plan->way == FULL && plan->call >= 0 && (call == WRITE || call == OPEN))
        return plan->call == (int32_t)call ? number >= plan->at : plan->seen[plan->call] >= plan->at;
    return plan->call == (int32_t)call && number == plan->at;
}

static int fail(void) {
    if (plan->way == KILL) raise(SIGKILL);
    errno = plan->way == FULL ? ENOSPC : plan->error;
    return -1;
}

#define REAL(name) __typeof__(&name) real_##name = (__typeof__(&name))dlsym(RTLD_NEXT, #name)

/* How many bytes of a write go through: all, half, or none (-1). */
static ssize_t part_of(int file, size_t size) {
    if (!plan || !file_is_below(file) || !is_meant(WRITE)) return (ssize_t)size;
    int halved = plan->way == SHORT || (plan->way == FULL && plan->call == WRITE && plan->seen[WRITE] == plan->at);
    return halved && size > 1 ? (ssize_t)(size / 2) : plan->way == SHORT ? (ssize_t)size : -1;
}

ssize_t write(int file, const void *bytes, size_t size) {
    REAL(write);
    ssize_t part = part_of(file, size);
    if (part < 0 && plan->way == KILL) real_write(file, bytes, size / 2); /* a torn write */
    return part < 0 ? fail() : real_write(file, bytes, (size_t)part);
}

ssize_t pwrite64(int file, const void *bytes, size_t size, off64_t offset) {
    REAL(pwrite64);
    ssize_t part = part_of(file, size);
    return part < 0 ? fail() : real_pwrite64(file, bytes, (size_t)part, offset);
}

ssize_t pwrite(int file, const void *bytes, size_t size, off_t offset) { return pwrite64(file, bytes, size, offset); }

ssize_t writev(int file, const struct iovec *parts, int count) {
    REAL(write);
    REAL(writev);
    size_t size = 0;
    for (int i = 0; i < count; ++i) size += parts[i].iov_len;
    ssize_t part = part_of(file, size);
    if (part < 0) return fail();
    if ((size_t)part == size) return real_writev(file, parts, count);
    return real_write(file, parts[0].iov_base, parts[0].iov_len < (size_t)part ? parts[0].iov_len : (size_t)part);
}

int fsync(int file) {
    REAL(fsync);
    return plan && file_is_below(file) && is_meant(SYNC) ? fail() : real_fsync(file);
}

int fdatasync(int file) {
    REAL(fdatasync);
    return plan && file_is_below(file) && is_meant(SYNC) ? fail() : real_fdatasync(file);
}

int rename(const char *from, const char *to) {
    REAL(rename);
    return plan && path_is_below(to) && is_meant(RENAME) ? fail() : real_rename(from, to);
}

int renameat(int from_folder, const char *from, int to_folder, const char *to) {
    REAL(renameat);
    return plan && path_is_below(to) && is_meant(RENAME) ? fail() : real_renameat(from_folder, from, to_folder, to);
}

#define OPEN_LIKE(name, declared, passed, path)                                                                        \
    int name declared {                                                                                                \
        REAL(name);                                                                                                    \
        mode_t mode = 0;                                                                                               \
        if (flags & (O_CREAT | O_TMPFILE)) {                                                                           \
            va_list more;                                                                                              \
            va_start(more, flags);                                                                                     \
            mode = va_arg(more, mode_t);                                                                               \
            va_end(more);                                                                                              \
        }                                                                                                              \
        if (plan && (flags & (O_WRONLY | O_RDWR)) && path_is_below(path) && is_meant(OPEN)) return fail();             \
        return real_##name passed;                                                                                     \
    }

OPEN_LIKE(open, (const char *path, int flags, ...), (path, flags, mode), path)
OPEN_LIKE(open64, (const char *path, int flags, ...), (path, flags, mode), path)
OPEN_LIKE(openat, (int folder, const char *path, int flags, ...), (folder, path, flags, mode), path)
OPEN_LIKE(openat64, (int folder, const char *path, int flags, ...), (folder, path, flags, mode), path)
