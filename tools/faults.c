/* Lets one system call on a file fail, for tools/trials: preloaded, it counts calls that create, write, map, cut, sync or
 * rename regular files. TRIAL_FAULT=N makes call N fail as a full or broken disk would, TRIAL_STICKY=1 all calls from N
 * on, TRIAL_KINDS=letters counts those kinds alone (o w m t s r), TRIAL_COUNT=FILE receives the number of calls. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>

static atomic_long calls;
static long at = -1;
static int sticky;
static const char *kinds;
static const char *count_file;

__attribute__((constructor)) static void begin(void) {
    const char *text = getenv("TRIAL_FAULT");
    at = text ? atol(text) : -1;
    sticky = getenv("TRIAL_STICKY") != NULL;
    kinds = getenv("TRIAL_KINDS");
    count_file = getenv("TRIAL_COUNT");
}

__attribute__((destructor)) static void end(void) {
    if (!count_file) return;
    FILE *file = fopen(count_file, "w");
    if (!file) return;
    fprintf(file, "%ld\n", (long)atomic_load(&calls));
    fclose(file);
}

/* Whether this call is the one that fails. */
static int fails(char kind, int error) {
    if (kinds && !strchr(kinds, kind)) return 0;
    long call = atomic_fetch_add(&calls, 1) + 1;
    if (at < 0 || (sticky ? call < at : call != at)) return 0;
    errno = error;
    return 1;
}

static int regular(int fd) {
    struct stat status;
    return fd > 2 && fstat(fd, &status) == 0 && S_ISREG(status.st_mode);
}

#define REAL(name) static __typeof__(&name) real; if (!real) real = (__typeof__(&name))dlsym(RTLD_NEXT, #name)

#define OPEN(name) \
    int name(const char *path, int flags, ...) { \
        REAL(name); \
        va_list list; va_start(list, flags); mode_t mode = va_arg(list, mode_t); va_end(list); \
        if ((flags & O_CREAT) && fails('o', EACCES)) return -1; \
        return real(path, flags, mode); \
    }
OPEN(open)
OPEN(open64)

ssize_t write(int fd, const void *data, size_t size) {
    REAL(write);
    if (regular(fd) && fails('w', ENOSPC)) return -1;
    return real(fd, data, size);
}

ssize_t writev(int fd, const struct iovec *pieces, int count) {
    REAL(writev);
    if (regular(fd) && fails('w', ENOSPC)) return -1;
    return real(fd, pieces, count);
}

#define PWRITE(name, type) \
    ssize_t name(int fd, const void *data, size_t size, type offset) { \
        REAL(name); \
        if (regular(fd) && fails('w', ENOSPC)) return -1; \
        return real(fd, data, size, offset); \
    }
PWRITE(pwrite, off_t)
PWRITE(pwrite64, off64_t)

#define MMAP(name, type) \
    void *name(void *place, size_t size, int protection, int flags, int fd, type offset) { \
        REAL(name); \
        if (fd > 2 && fails('m', ENOMEM)) return MAP_FAILED; \
        return real(place, size, protection, flags, fd, offset); \
    }
MMAP(mmap, off_t)
MMAP(mmap64, off64_t)

#define TRUNCATE(name, type) \
    int name(int fd, type size) { REAL(name); if (fails('t', ENOSPC)) return -1; return real(fd, size); }
TRUNCATE(ftruncate, off_t)
TRUNCATE(ftruncate64, off64_t)

int fallocate(int fd, int mode, off_t offset, off_t size) {
    REAL(fallocate);
    if (fails('t', ENOSPC)) return -1;
    return real(fd, mode, offset, size);
}
int fallocate64(int fd, int mode, off64_t offset, off64_t size) {
    REAL(fallocate64);
    if (fails('t', ENOSPC)) return -1;
    return real(fd, mode, offset, size);
}
int posix_fallocate(int fd, off_t offset, off_t size) {
    REAL(posix_fallocate);
    if (fails('t', ENOSPC)) return ENOSPC;
    return real(fd, offset, size);
}
int posix_fallocate64(int fd, off64_t offset, off64_t size) {
    REAL(posix_fallocate64);
    if (fails('t', ENOSPC)) return ENOSPC;
    return real(fd, offset, size);
}

int fsync(int fd) { REAL(fsync); if (fails('s', EIO)) return -1; return real(fd); }
int fdatasync(int fd) { REAL(fdatasync); if (fails('s', EIO)) return -1; return real(fd); }
int msync(void *place, size_t size, int flags) {
    REAL(msync);
    if (fails('s', EIO)) return -1;
    return real(place, size, flags);
}
int rename(const char *from, const char *to) { REAL(rename); if (fails('r', EACCES)) return -1; return real(from, to); }
