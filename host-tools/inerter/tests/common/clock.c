/* Preloaded into a program: somebody sets the computer's clock again and again, by hours and days, forwards and back.
 *
 * Only CLOCK_REALTIME is moved: what counts the time itself goes on. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <sys/time.h>
#include <time.h>

static const long STEPS_S[] = { 0, 3600, -86400, 30, -1, 1000000, -3600, 0, 7 };

static int real(clockid_t clock, struct timespec *now)
{
    static int (*next)(clockid_t, struct timespec *);
    if (next == NULL)
        next = (int (*)(clockid_t, struct timespec *))dlsym(RTLD_NEXT, "clock_gettime");
    return next(clock, now);
}

int clock_gettime(clockid_t clock, struct timespec *now)
{
    int result = real(clock, now);
    if (result == 0 && (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE)) {
        struct timespec steady;
        real(CLOCK_MONOTONIC, &steady);
        /* Another step every 200 ms. */
        long place = steady.tv_sec * 5 + steady.tv_nsec / 200000000;
        now->tv_sec += STEPS_S[place % (long)(sizeof STEPS_S / sizeof *STEPS_S)];
    }
    return result;
}

int gettimeofday(struct timeval *restrict now, void *restrict zone)
{
    struct timespec moved;
    (void)zone;
    int result = clock_gettime(CLOCK_REALTIME, &moved);
    now->tv_sec = moved.tv_sec;
    now->tv_usec = moved.tv_nsec / 1000;
    return result;
}

time_t time(time_t *into)
{
    struct timespec moved;
    clock_gettime(CLOCK_REALTIME, &moved);
    if (into != NULL)
        *into = moved.tv_sec;
    return moved.tv_sec;
}
