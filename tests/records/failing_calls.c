/* Preloaded into a program: the n-th of its system calls that change or open files of one folder fails. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/sendfile.h>
#include <sys/types.h>
#include <unistd.h>

#define FILES 4096

static char folder[4096];
static char inside[FILES];         /* by file descriptor */
static long nth, calls;            /* nth 0: none fails */
static int fault, part, stays;     /* the error; half of a write succeeds; all later calls fail too */

void arm(const char *path, long which, int error, int half, int all_later)
{
  strncpy(folder, path, sizeof folder - 1);
  memset(inside, 0, sizeof inside);
  nth = which, calls = 0, fault = error, part = half, stays = all_later;
}

long counted(void) { return calls; }

static int is_inside(const char *path) { return folder[0] && path && !strncmp(path, folder, strlen(folder)); }

static int fails(void)
{
  calls++;
  if (nth && (calls == nth || (stays && calls > nth))) {
    errno = fault;
    return 1;
  }
  return 0;
}

#define REAL(name) __typeof__(name) *real = dlsym(RTLD_NEXT, #name)

#define OPEN(name)                                                \
  int name(const char *path, int flags, ...)                      \
  {                                                               \
    REAL(name);                                                   \
    va_list more;                                                 \
    va_start(more, flags);                                        \
    mode_t mode = va_arg(more, mode_t);                           \
    va_end(more);                                                 \
    int ours = is_inside(path);                                   \
    if (ours && !part && (!stays || flags & O_CREAT) && fails())  \
      return -1;                                                  \
    int file = real(path, flags, mode);                           \
    if (file >= 0 && file < FILES)                                \
      inside[file] = ours;                                        \
    return file;                                                  \
  }

OPEN(open)
OPEN(open64)

ssize_t write(int file, const void *bytes, size_t count)
{
  REAL(write);
  if (file < 0 || file >= FILES || !inside[file] || !fails())
    return real(file, bytes, count);
  return part && count > 1 && calls == nth ? real(file, bytes, count / 2) : part && calls == nth ? real(file, bytes, count) : -1;
}

ssize_t sendfile(int to, int from, off_t *offset, size_t count)
{
  REAL(sendfile);
  return to >= 0 && to < FILES && inside[to] && !part && fails() ? -1 : real(to, from, offset, count);
}

int fsync(int file)
{
  REAL(fsync);
  return file >= 0 && file < FILES && inside[file] && !part && (!stays || fault == EROFS) && fails() ? -1 : real(file);
}

int rename(const char *from, const char *to)
{
  REAL(rename);
  return is_inside(to) && !part && fails() ? -1 : real(from, to);
}

int mkdir(const char *path, mode_t mode)
{
  REAL(mkdir);
  return is_inside(path) && !part && fails() ? -1 : real(path, mode);
}

int unlink(const char *path)
{
  REAL(unlink);
  return is_inside(path) && !part && !stays && fails() ? -1 : real(path);
}

int chmod(const char *path, mode_t mode)
{
  REAL(chmod);
  return is_inside(path) && !part && !stays && fails() ? -1 : real(path, mode);
}
