/* Time of grblHAL's simulator, preloaded into it: `LD_PRELOAD=hal_time.so HAL_TIME=file HAL_PACE=2 grblHAL_sim ...`.

   The simulator runs 20 ms of its controller at once and sleeps for the rest. The controller's main loop is a thread of
   its own, which a busy machine may leave without its turn until the steps that it has prepared run out: a move then
   ends early. Here its clock moves by what it sleeps, no frame begins before the main loop has had some turns, and the
   time is written to `file` (8 bytes, ns) for the host. A busy machine makes a test slower, never wrong. */

#define _GNU_SOURCE
#include <fcntl.h>
#include <poll.h>
#include <stdatomic.h>
#include <signal.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#define FRAME_WORK_NS 100000 /* what a frame takes by this clock, beside the sleep */
#define TURN_NS 50000        /* real */
#define TURNS_PER_FRAME 4
#define MOST_RESTS 10000 /* half a second: it hangs, and the host shall see so */

static _Atomic int64_t *now_ns;
static double pace = 1.0;
static atomic_int line = -1;
static atomic_ulong turns;

static void rest(int64_t ns)
{
    struct timespec time = {ns / 1000000000, ns % 1000000000};
    clock_nanosleep(CLOCK_MONOTONIC, 0, &time, NULL);
}

__attribute__((constructor)) static void start(void)
{
    int file = open(getenv("HAL_TIME"), O_RDWR);
    now_ns = mmap(NULL, sizeof *now_ns, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    pace = atof(getenv("HAL_PACE"));
    prctl(PR_SET_PDEATHSIG, SIGKILL); /* a test that was killed leaves nothing behind */
}

int clock_gettime(clockid_t clock, struct timespec *time)
{
    int64_t ns = *now_ns += FRAME_WORK_NS;
    (void)clock;
    time->tv_sec = ns / 1000000000;
    time->tv_nsec = ns % 1000000000;
    return 0;
}

/* The end of a frame: sleep, or go on at once where the host has written something. */
int nanosleep(const struct timespec *time, struct timespec *left)
{
    int64_t ns = time->tv_sec * 1000000000 + time->tv_nsec;
    int64_t real_ns = ns / pace;
    struct timespec at_most = {real_ns / 1000000000, real_ns % 1000000000};
    struct pollfd input = {line, POLLIN, 0};
    unsigned long until = turns + TURNS_PER_FRAME;
    (void)left;
    ppoll(&input, 1, &at_most, NULL);
    if (input.revents & (POLLNVAL | POLLERR))
        line = -1;
    for (int n = 0; n < MOST_RESTS && (long)(until - turns) > 0; n++)
        rest(TURN_NS);
    *now_ns += ns;
    return 0;
}

/* One turn of the controller's main loop. */
int sched_yield(void)
{
    turns++;
    rest(TURN_NS);
    return 0;
}

int accept(int listening, struct sockaddr *address, socklen_t *length)
{
    line = syscall(SYS_accept, listening, address, length);
    return line;
}
