/* Faults of the disk at chosen moments: loaded before libc (LD_PRELOAD), it counts what a process changes below a folder
 * and, at the k-th change, kills the process or has the system refuse. Between two changes a killed process leaves the
 * same files whenever it is killed, so that all k together are all moments at which it can be. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

enum { COUNT, KILL, TORN, FULL, BROKEN };
enum { WRITE, MAKE, FLUSH, NAME, REMOVE };

static char folder[PATH_MAX];
static long limit, count;
static int mode;

void fault_arm(const char *below, long at, int how) {
    strncpy(folder, below, sizeof folder - 1);
    limit = at, mode = how, count = 0;
}
long fault_count(void) { return count; }

static int ours(const char *path) {
    char whole[PATH_MAX], base[PATH_MAX];
    if (!folder[0] || !path) return 0;
    if (path[0] != '/') {
        if (!getcwd(base, sizeof base)) return 0;
        if (snprintf(whole, sizeof whole, "%s/%s", base, path) >= (int)sizeof whole) return 0;
        path = whole;
    }
    return strncmp(path, folder, strlen(folder)) == 0;
}

static int ours_fd(int fd) {
    char link[64], path[PATH_MAX];
    if (!folder[0]) return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t size = readlink(link, path, sizeof path - 1);
    if (size < 0) return 0;
    path[size] = 0;
    return ours(path);
}

/* Whether the change is refused (errno is set). What is torn is done by half first, by the caller. */
static int refused(int kind, int *torn) {
    *torn = 0;
    count++;
    if (mode == COUNT || count < limit) return 0;
    if (mode == KILL && count == limit) kill(getpid(), SIGKILL);
    if (mode == TORN && count == limit) *torn = 1;
    if (mode == FULL && (kind == WRITE || kind == MAKE)) return errno = ENOSPC, 1;
    if (mode == BROKEN && count == limit && kind != REMOVE) return errno = EIO, 1;
    return 0;
}

#define REAL(name) \
    static __typeof__(&name) real; \
    if (!real) real = (__typeof__(&name))dlsym(RTLD_NEXT, #name)
#define AFTER(torn) \
    if (torn) kill(getpid(), SIGKILL)

ssize_t write(int fd, const void *data, size_t size) {
    REAL(write);
    int torn;
    if (!ours_fd(fd)) return real(fd, data, size);
    if (refused(WRITE, &torn)) return -1;
    ssize_t done = real(fd, data, torn ? size / 2 : size);
    AFTER(torn);
    return done;
}

#define PWRITE(name, offset_type) \
    ssize_t name(int fd, const void *data, size_t size, offset_type at) { \
        REAL(name); \
        int torn; \
        if (!ours_fd(fd)) return real(fd, data, size, at); \
        if (refused(WRITE, &torn)) return -1; \
        ssize_t done = real(fd, data, torn ? size / 2 : size, at); \
        AFTER(torn); \
        return done; \
    }
PWRITE(pwrite, off_t)
PWRITE(pwrite64, off64_t)

#define OPEN(name) \
    int name(const char *path, int flags, ...) { \
        REAL(name); \
        va_list more; \
        va_start(more, flags); \
        int rights = flags & (O_CREAT | O_TMPFILE) ? va_arg(more, int) : 0, torn = 0; \
        va_end(more); \
        if (flags & O_CREAT && access(path, F_OK) && ours(path) && refused(MAKE, &torn)) return -1; \
        int fd = real(path, flags, rights); \
        AFTER(torn); \
        return fd; \
    }
OPEN(open)
OPEN(open64)

#define FLUSHING(name) \
    int name(int fd) { \
        REAL(name); \
        int torn = 0; \
        if (ours_fd(fd) && refused(FLUSH, &torn)) return -1; \
        int done = real(fd); \
        AFTER(torn); \
        return done; \
    }
FLUSHING(fsync)
FLUSHING(fdatasync)

int rename(const char *from, const char *to) {
    REAL(rename);
    int torn = 0;
    if (ours(to) && refused(NAME, &torn)) return -1;
    int done = real(from, to);
    AFTER(torn);
    return done;
}

int mkdir(const char *path, mode_t rights) {
    REAL(mkdir);
    int torn = 0;
    if (access(path, F_OK) && ours(path) && refused(MAKE, &torn)) return -1;
    int done = real(path, rights);
    AFTER(torn);
    return done;
}

#define TRUNCATE(name, offset_type) \
    int name(int fd, offset_type size) { \
        REAL(name); \
        int torn = 0; \
        if (ours_fd(fd) && refused(NAME, &torn)) return -1; \
        int done = real(fd, size); \
        AFTER(torn); \
        return done; \
    }
TRUNCATE(ftruncate, off_t)
TRUNCATE(ftruncate64, off64_t)

int unlink(const char *path) {
    REAL(unlink);
    int torn = 0;
    if (ours(path) && refused(REMOVE, &torn)) return -1;
    int done = real(path);
    AFTER(torn);
    return done;
}
