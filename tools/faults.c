/* Lets calls on files fail, for tools/trials: preloaded, it counts calls that create, write, read, map, cut, reserve, sync or rename
 * files. A call site is a kind of call and the frames of the program that lead to it, as a hash that is the same in every run.
 *
 *   TRIAL_SITE=HEX TRIAL_NTH=N   call N of this site fails as a full or broken disk would
 *   TRIAL_FAULT=N                call N of all fails
 *   TRIAL_STICKY=1               all calls after that one fail, too; reads only if it is a read
 *   TRIAL_KINDS=letters          counts those kinds alone: o w i m t a s r
 *   TRIAL_COUNT=FILE             receives the number of calls and of those that failed
 *   TRIAL_SITES=FILE             receives a line per site: hash, kind, calls, frames */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <execinfo.h>
#include <fcntl.h>
#include <link.h>
#include <linux/audit.h>
#include <linux/filter.h>
#include <linux/seccomp.h>
#include <signal.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <ucontext.h>
#include <unistd.h>

/* Frames of the program that tell sites apart. */
#define FRAMES 12
/* Places for sites; a power of two, many times what a run has. */
#define SITES 16384

struct site {
    _Atomic uint64_t hash;
    atomic_long calls;
    char kind;
    uint32_t frames[FRAMES];
};

static struct site sites[SITES];
static atomic_long calls, failed;
static atomic_int broken;
static long at = -1, nth = -1;
static uint64_t wanted;
static int sticky;
static const char *kinds, *count_file, *sites_file;
static uintptr_t base, from, to;
static __thread int busy;

/* The first object is the program. */
static int program(struct dl_phdr_info *info, size_t size, void *data) {
    base = info->dlpi_addr;
    from = UINTPTR_MAX;
    for (int i = 0; i < info->dlpi_phnum; i++) {
        if (info->dlpi_phdr[i].p_type != PT_LOAD) continue;
        uintptr_t start = base + info->dlpi_phdr[i].p_vaddr, stop = start + info->dlpi_phdr[i].p_memsz;
        if (start < from) from = start;
        if (stop > to) to = stop;
    }
    return 1;
}

/* The site of this call, NULL if there is no place for it. */
static struct site *site_of(char kind) {
    void *stack[64];
    uint32_t frames[FRAMES] = {0};
    int depth = backtrace(stack, 64), used = 0;
    uint64_t hash = 0xcbf29ce484222325u ^ (unsigned char)kind;
    for (int i = 0; i < depth && used < FRAMES; i++) {
        uintptr_t place = (uintptr_t)stack[i];
        if (place < from || place >= to) continue;
        frames[used++] = place - base;
        hash = (hash ^ (place - base)) * 0x100000001b3u;
        hash ^= hash >> 29;
    }
    if (!hash) hash = 1;
    for (int i = 0; i < SITES; i++) {
        struct site *site = &sites[(hash + i) & (SITES - 1)];
        uint64_t there = 0;
        if (atomic_compare_exchange_strong(&site->hash, &there, hash)) {
            site->kind = kind;
            memcpy(site->frames, frames, sizeof frames);
            return site;
        }
        if (there == hash) return site;
    }
    return NULL;
}

/* Whether this call fails. */
static int fails(char kind, int error) {
    if (busy || (kinds && !strchr(kinds, kind))) return 0;
    int before = errno;
    long call = atomic_fetch_add(&calls, 1) + 1;
    int hit = call == at;
    if (sites_file || nth >= 0) {
        busy = 1;
        struct site *site = site_of(kind);
        long mine = site ? atomic_fetch_add(&site->calls, 1) + 1 : 0;
        hit = site && site->hash == wanted && mine == nth;
        busy = 0;
    }
    /* A full disk can still be read. */
    if (hit && sticky) atomic_store(&broken, kind == 'i' ? 2 : 1);
    hit |= atomic_load(&broken) > (kind == 'i');
    errno = before;
    if (!hit) return 0;
    atomic_fetch_add(&failed, 1);
    errno = error;
    return 1;
}

#ifdef __x86_64__
/* Calls of fallocate that no library makes, but the program itself, end in a signal; this last argument tells ours apart. */
#define OURS 0x7472691

static void reserve(int number, siginfo_t *info, void *context) {
    greg_t *r = ((ucontext_t *)context)->uc_mcontext.gregs;
    int before = errno;
    if (fails('a', ENOSPC)) {
        r[REG_RAX] = -ENOSPC;
    } else {
        long result = syscall(SYS_fallocate, r[REG_RDI], r[REG_RSI], r[REG_RDX], r[REG_R10], 0, OURS);
        r[REG_RAX] = result < 0 ? -errno : result;
    }
    errno = before;
}

static void watch_reserving(void) {
    struct sigaction action = {.sa_sigaction = reserve, .sa_flags = SA_SIGINFO | SA_RESTART};
    sigaction(SIGSYS, &action, NULL);
    struct sock_filter rules[] = {
        BPF_STMT(BPF_LD | BPF_W | BPF_ABS, offsetof(struct seccomp_data, arch)),
        BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, AUDIT_ARCH_X86_64, 0, 5),
        BPF_STMT(BPF_LD | BPF_W | BPF_ABS, offsetof(struct seccomp_data, nr)),
        BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, SYS_fallocate, 0, 3),
        BPF_STMT(BPF_LD | BPF_W | BPF_ABS, offsetof(struct seccomp_data, args[5])),
        BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, OURS, 1, 0),
        BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_TRAP),
        BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ALLOW),
    };
    struct sock_fprog all = {sizeof rules / sizeof *rules, rules};
    if (prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) || prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, &all)) {
        perror("faults.c: calls of fallocate cannot be watched");
        _exit(99);
    }
}
#else
static void watch_reserving(void) {}
#endif

__attribute__((constructor)) static void begin(void) {
    const char *text = getenv("TRIAL_FAULT");
    at = text ? atol(text) : -1;
    if ((text = getenv("TRIAL_SITE"))) {
        wanted = strtoull(text, NULL, 16);
        nth = (text = getenv("TRIAL_NTH")) ? atol(text) : 1;
    }
    sticky = getenv("TRIAL_STICKY") != NULL;
    kinds = getenv("TRIAL_KINDS");
    count_file = getenv("TRIAL_COUNT");
    sites_file = getenv("TRIAL_SITES");
    dl_iterate_phdr(program, NULL);
    /* The first call allocates. */
    void *stack[4];
    backtrace(stack, 4);
    watch_reserving();
}

__attribute__((destructor)) static void end(void) {
    busy = 1;
    FILE *file;
    if (count_file && (file = fopen(count_file, "w"))) {
        fprintf(file, "%ld %ld\n", (long)atomic_load(&calls), (long)atomic_load(&failed));
        fclose(file);
    }
    if (!sites_file || !(file = fopen(sites_file, "w"))) return;
    for (int i = 0; i < SITES; i++) {
        if (!sites[i].hash) continue;
        fprintf(file, "%016lx %c %ld", (unsigned long)sites[i].hash, sites[i].kind, (long)sites[i].calls);
        for (int k = 0; k < FRAMES && sites[i].frames[k]; k++) fprintf(file, " %x", sites[i].frames[k]);
        fputc('\n', file);
    }
    fclose(file);
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

int mkdir(const char *path, mode_t mode) { REAL(mkdir); if (fails('o', EACCES)) return -1; return real(path, mode); }

ssize_t read(int fd, void *data, size_t size) {
    REAL(read);
    if (regular(fd) && fails('i', EIO)) return -1;
    return real(fd, data, size);
}

#define PREAD(name, type) \
    ssize_t name(int fd, void *data, size_t size, type offset) { \
        REAL(name); \
        if (regular(fd) && fails('i', EIO)) return -1; \
        return real(fd, data, size, offset); \
    }
PREAD(pread, off_t)
PREAD(pread64, off64_t)

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

int fsync(int fd) { REAL(fsync); if (fails('s', EIO)) return -1; return real(fd); }
int fdatasync(int fd) { REAL(fdatasync); if (fails('s', EIO)) return -1; return real(fd); }
int msync(void *place, size_t size, int flags) {
    REAL(msync);
    if (fails('s', EIO)) return -1;
    return real(place, size, flags);
}
int rename(const char *from, const char *to) { REAL(rename); if (fails('r', EACCES)) return -1; return real(from, to); }
