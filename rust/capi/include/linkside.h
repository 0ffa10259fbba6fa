// Link-side state estimation for robots with elastic joints: estimators from files that `linkside compile` writes.
//
// Written by cbindgen (`make header`): do not edit.
//
// Memory: once an estimator is made, no function allocates, asks the operating system or waits, until `linkside_free`.
// Threads: use an estimator from one thread at a time; different estimators share nothing.
// Errors: a function that can fail gives a LinksideResult, and `linkside_error` says in a line what was wrong, and where.

#ifndef LINKSIDE_H
#define LINKSIDE_H

#include <stddef.h>
#include <stdint.h>

// Some combination of accelerations was damped near a singular posture.
#define LINKSIDE_DAMPED 1

// A reading was missing and bridged.
#define LINKSIDE_BRIDGED 2

// Some combination of accelerations was not observed at all.
#define LINKSIDE_UNSEEN 4

// A reading was left out as an outlier.
#define LINKSIDE_GATED 8

// No reading was used: the estimate is a prediction.
#define LINKSIDE_PREDICTED 16

// An encoder wrapped, and its jump was removed.
#define LINKSIDE_UNWRAPPED 32

// Readings contradict the model: do not use the estimate and its standard deviations.
#define LINKSIDE_CONTRADICTED 64

// One channel contradicts the model and all others.
#define LINKSIDE_FAULTY 128

// The result of a call.
typedef enum LinksideResult {
  // It is done.
  LINKSIDE_OK = 0,
  // The sample, or an argument, cannot be used; everything is as it was before the call.
  LINKSIDE_REFUSED = 1,
  // The sample's readings are so extreme that no estimate is left; the next sample starts again.
  LINKSIDE_LOST = 2,
  // A pointer is null that must not be.
  LINKSIDE_NULL = 3,
  // The file cannot be used: read `linkside_last_error`.
  LINKSIDE_FILE = 4,
  // A fault of this library: every later call of the estimator returns the same. Please report it.
  LINKSIDE_FAULT = 5,
} LinksideResult;

// An estimator, made by `linkside_read` or `linkside_from_bytes`.
typedef struct LinksideEstimator LinksideEstimator;

// One sample of a robot's signals, on the link side of gears, in SI units; NaN where a reading is missing.
//
// Each signal is an array of as many numbers as `linkside_width` says, or null where it is missing. A signal that the
// estimator does not read is ignored. Begin with `{0}`, so that fields you do not set are null.
typedef struct LinksideSample {
  // Time since the sample before [s]; filters need it, observers have the period that they were designed for.
  double dt;
  // Motor positions [rad].
  const double *theta;
  // Motor velocities [rad/s].
  const double *dtheta;
  // Motor torques [N m].
  const double *tau;
  // Accelerometer channels [m/s²].
  const double *acceleration;
  // Gyroscope channels [rad/s].
  const double *rate;
  // Link positions [rad].
  const double *q;
  // Link velocities [rad/s].
  const double *dq;
  // Link accelerations [rad/s²].
  const double *ddq;
  // Torques of joint torque sensors [N m].
  const double *torque;
  // Commanded link accelerations [rad/s²].
  const double *ddqref;
  // Forces and moments from outside that sensors measure, six numbers each [N, N m].
  const double *wrench;
  // Channels of trackers [m].
  const double *position;
} LinksideSample;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// Reads the file at `path`, which `linkside compile` has written, and makes its estimator; `*out` is null where it fails.
//
// # Safety
// `path` is a string, `out` may be written. Free the estimator with `linkside_free`.
enum LinksideResult linkside_read(const char *path,
                                  struct LinksideEstimator **out);

// Like `linkside_read`, from the `length` bytes of a file in memory.
//
// # Safety
// `content` has `length` bytes, `out` may be written. Free the estimator with `linkside_free`.
enum LinksideResult linkside_from_bytes(const uint8_t *content, size_t length, struct LinksideEstimator **out);

// Frees an estimator; null is ignored.
//
// # Safety
// `estimator` came from this library, and is not used again.
void linkside_free(struct LinksideEstimator *estimator);

// Why the last `linkside_read` or `linkside_from_bytes` of this thread failed; valid until its next one.
const char *linkside_last_error(void);

// Why the last call on this estimator failed; empty where none has. Valid until its next call.
//
// # Safety
// `estimator` is one, or null, which gives null.
const char *linkside_error(const struct LinksideEstimator *estimator);

// Takes one sample; afterwards what `linkside_values` points to is the estimate at its time.
//
// # Safety
// `estimator` is one, `sample` a sample with as many numbers a signal as `linkside_width` says.
enum LinksideResult linkside_step(struct LinksideEstimator *estimator, const struct LinksideSample *sample);

// Forgets all samples: the next one starts again.
//
// # Safety
// `estimator` is one, or null.
enum LinksideResult linkside_reset(struct LinksideEstimator *estimator);

// A part of the estimate by name: `t`, `q`, `dq`, `ddq`, `theta`, `dtheta`, `tool_position`; of filters and of the
// acceleration-driven observer also `q_std`, `tool_std`; of filters `disturbance`, `disturbance_std`, `wrench`, `wrench_std`,
// `nis`, `log_likelihood`, `used`, `state`; of velocity observers `level`.
//
// Null of a name that the estimator does not have. The pointer, and `*length`, stay valid until `linkside_free`: ask once,
// before the loop. NaN before there is an estimate.
//
// # Safety
// `estimator` is one or null, `name` a string, `length` may be written or is null.
const double *linkside_values(const struct LinksideEstimator *estimator,
                              const char *name,
                              size_t *length);

// Status of the last sample, a sum of `LINKSIDE_DAMPED` and the other flags; 0 is good.
//
// # Safety
// `estimator` is one, or null, which gives 0.
uint8_t linkside_status(const struct LinksideEstimator *estimator);

// Writes the covariance of a filter's `state`, by rows, into `out` of `length` numbers: the square of `linkside_states`.
//
// # Safety
// `estimator` is one, `out` has `length` numbers.
enum LinksideResult linkside_covariance(struct LinksideEstimator *estimator,
                                        double *out,
                                        size_t length);

// Number of states of a filter; 0 of an observer, which has no covariance.
//
// # Safety
// `estimator` is one, or null, which gives 0.
size_t linkside_states(const struct LinksideEstimator *estimator);

// Number of joints.
//
// # Safety
// `estimator` is one, or null, which gives 0.
size_t linkside_joints(const struct LinksideEstimator *estimator);

// How many numbers the signal `name` of a sample has, called as the fields of `LinksideSample`; 0 where it is not read.
//
// # Safety
// `estimator` is one, or null, `name` a string.
size_t linkside_width(const struct LinksideEstimator *estimator, const char *name);

// Name of entry `index` of the signal `name`: a joint, or a channel of a sensor; null where there is none.
//
// # Safety
// `estimator` is one, or null, `name` a string. The answer is valid until `linkside_free`.
const char *linkside_name(const struct LinksideEstimator *estimator, const char *name, size_t index);

// The method: `observer`, `ekf`, `elastic-ekf` or `velocity`; null of null.
//
// # Safety
// `estimator` is one, or null.
const char *linkside_method(const struct LinksideEstimator *estimator);

// The sampling period that an observer was designed for [s]; 0 of filters, which take any.
//
// # Safety
// `estimator` is one, or null, which gives 0.
double linkside_period(const struct LinksideEstimator *estimator);

// Version of this library, 1000 000 major + 1000 minor + patch.
int linkside_version(void);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* LINKSIDE_H */
