// What a control loop must not do: allocate, or ask the operating system for anything.
//
//     loop robot.lsr samples out
//
// `samples` are doubles: dt and then all signals that the estimator reads, as `linkside_width` has them. Where the
// kernel allows it, the loop runs in strict seccomp mode, in which any system call but read, write and exit kills.
// Exit status 0: done; 3: done, but without seccomp.

#include "linkside.h"

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <linux/seccomp.h>
#include <unistd.h>
#include <vector>

static size_t allocations = 0;

extern "C" {
void *__libc_malloc(size_t);
void *__libc_calloc(size_t, size_t);
void *__libc_realloc(void *, size_t);
void __libc_free(void *);

void *malloc(size_t size) { ++allocations; return __libc_malloc(size); }
void *calloc(size_t count, size_t size) { ++allocations; return __libc_calloc(count, size); }
void *realloc(void *old, size_t size) { ++allocations; return __libc_realloc(old, size); }
void free(void *old) { ++allocations; __libc_free(old); }
}

static void die(const char *why) {
    (void)!write(2, why, std::strlen(why));
    (void)!write(2, "\n", 1);
    syscall(SYS_exit, 1);
}

int main(int count, char **arguments) {
    LinksideEstimator *e = nullptr;
    if (count != 4 || linkside_read(arguments[1], &e) != LINKSIDE_OK) {
        die(linkside_last_error());
    }
    LinksideSample sample = {};
    const char *const names[] = {"theta", "dtheta", "tau", "acceleration", "rate", "q", "dq", "ddq", "torque", "ddqref", "wrench"};
    const double **const fields[] = {&sample.theta, &sample.dtheta, &sample.tau, &sample.acceleration, &sample.rate,
                                     &sample.q,     &sample.dq,     &sample.ddq, &sample.torque,       &sample.ddqref,
                                     &sample.wrench};
    size_t width = 1;
    for (int s = 0; s < 11; ++s) {
        width += linkside_width(e, names[s]);
    }
    std::vector<double> samples;
    std::FILE *file = std::fopen(arguments[2], "rb");
    for (double value; file != nullptr && std::fread(&value, sizeof value, 1, file) == 1;) {
        samples.push_back(value);
    }
    const size_t rows = samples.size() / width;
    size_t n = 0;
    const double *q = linkside_values(e, "q", &n);
    const size_t states = linkside_states(e);
    std::vector<double> out(rows * (n + 1)), covariance(states * states), absurd(width, HUGE_VAL);
    std::FILE *written = std::fopen(arguments[3], "wb");
    const int target = fileno(written);

    const size_t before = allocations;
    ++allocations; // the counter counts
    if (allocations - before != 1) {
        die("allocations are not counted");
    }
    const bool strict = prctl(PR_SET_SECCOMP, SECCOMP_MODE_STRICT) == 0;
    const size_t start = allocations;
    for (int pass = 0; pass < 2; ++pass) {
        for (size_t i = 0; i < rows; ++i) {
            const double *row = &samples[i * width];
            sample.dt = *row++;
            for (int s = 0; s < 11; ++s) {
                const size_t own = linkside_width(e, names[s]);
                *fields[s] = own == 0 ? nullptr : row;
                row += own;
            }
            if (linkside_step(e, &sample) != LINKSIDE_OK) {
                die(linkside_error(e));
            }
            std::memcpy(&out[i * (n + 1)], q, n * sizeof(double));
            out[i * (n + 1) + n] = linkside_status(e);
            if (states > 0 && linkside_covariance(e, covariance.data(), covariance.size()) != LINKSIDE_OK) {
                die("no covariance");
            }
        }
        sample.theta = absurd.data();
        if (linkside_step(e, &sample) != LINKSIDE_REFUSED || std::strstr(linkside_error(e), "theta") == nullptr) {
            die("an infinite position was not refused");
        }
        if (pass == 0 && linkside_reset(e) != LINKSIDE_OK) {
            die("no reset");
        }
    }
    if (allocations != start) {
        die("the loop allocates");
    }
    (void)!write(target, out.data(), out.size() * sizeof(double));
    (void)!write(target, covariance.data(), covariance.size() * sizeof(double));
    syscall(SYS_exit, strict ? 0 : 3);
}
