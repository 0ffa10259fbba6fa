// Estimators of linkside in C++17, on top of linkside.h. A call that fails throws `linkside::Error`.

#ifndef LINKSIDE_HPP
#define LINKSIDE_HPP

#include "linkside.h"

#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

namespace linkside {

/// What was wrong, and whether the estimator is as it was before the call (`LINKSIDE_REFUSED`).
class Error : public std::runtime_error {
public:
    Error(LinksideResult result, const char *message) : std::runtime_error(message), result(result) {}

    LinksideResult result;
};

/// Numbers in memory that an estimator keeps: a view, which stays valid as long as the estimator.
class Values {
public:
    Values(const double *data, size_t size) : data_(data), size_(size) {}

    const double *begin() const noexcept { return data_; }
    const double *end() const noexcept { return data_ + size_; }
    const double *data() const noexcept { return data_; }
    size_t size() const noexcept { return size_; }
    double operator[](size_t index) const noexcept { return data_[index]; }

private:
    const double *data_;
    size_t size_;
};

/// An estimator, from a file that `linkside compile` has written.
class Estimator {
public:
    explicit Estimator(const std::string &path) : Estimator(made(linkside_read, path.c_str())) {}

    /// From a file's bytes.
    Estimator(const uint8_t *bytes, size_t size) : Estimator(made(linkside_from_bytes, bytes, size)) {}

    /// Takes a sample, for control loops: throws nothing. `error` says what was wrong.
    LinksideResult try_step(const LinksideSample &sample) noexcept { return linkside_step(handle_.get(), &sample); }

    /// Takes a sample.
    void step(const LinksideSample &sample) { check(try_step(sample)); }

    /// Forgets all samples.
    void reset() { check(linkside_reset(handle_.get())); }

    /// A part of the estimate: ask before the loop, read it after each step.
    Values values(const char *name) const {
        size_t size = 0;
        const double *data = linkside_values(handle_.get(), name, &size);
        if (data == nullptr) {
            throw Error(LINKSIDE_REFUSED, ("the " + method() + " has no " + name).c_str());
        }
        return {data, size};
    }

    /// Writes the covariance of the state, by rows.
    void covariance(std::vector<double> &out) {
        check(linkside_covariance(handle_.get(), out.data(), out.size()));
    }

    uint8_t status() const noexcept { return linkside_status(handle_.get()); }
    const char *error() const noexcept { return linkside_error(handle_.get()); }
    std::string method() const { return linkside_method(handle_.get()); }
    double period() const noexcept { return linkside_period(handle_.get()); }
    size_t joints() const noexcept { return linkside_joints(handle_.get()); }
    size_t states() const noexcept { return linkside_states(handle_.get()); }

    /// How many numbers a signal of a sample has; 0 where it is not read.
    size_t width(const char *signal) const noexcept { return linkside_width(handle_.get(), signal); }

    /// Names of the entries of a signal.
    std::vector<std::string> names(const char *signal) const {
        std::vector<std::string> names;
        for (size_t i = 0; i < width(signal); ++i) {
            names.emplace_back(linkside_name(handle_.get(), signal, i));
        }
        return names;
    }

private:
    struct Free {
        void operator()(LinksideEstimator *estimator) const noexcept { linkside_free(estimator); }
    };

    explicit Estimator(LinksideEstimator *handle) : handle_(handle) {}

    template <typename Make, typename... Arguments>
    static LinksideEstimator *made(Make make, Arguments... arguments) {
        LinksideEstimator *handle = nullptr;
        if (const LinksideResult result = make(arguments..., &handle); result != LINKSIDE_OK) {
            throw Error(result, linkside_last_error());
        }
        return handle;
    }

    void check(LinksideResult result) const {
        if (result != LINKSIDE_OK) {
            throw Error(result, error());
        }
    }

    std::unique_ptr<LinksideEstimator, Free> handle_;
};

} // namespace linkside

#endif
