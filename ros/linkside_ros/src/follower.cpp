#include <linkside_ros/follower.hpp>

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace linkside_ros {

namespace {

constexpr double MISSING = std::numeric_limits<double>::quiet_NaN();
constexpr std::size_t NOWHERE = std::numeric_limits<std::size_t>::max();
constexpr std::size_t MOST_WAITING = 256; // readings of an IMU whose joints do not come
constexpr std::int64_t LONG_AGO = std::numeric_limits<std::int64_t>::min() / 2;

double seconds(std::int64_t nanoseconds) { return 1e-9 * static_cast<double>(nanoseconds); }

const double *pointer(const std::vector<double> &signal) { return signal.empty() ? nullptr : signal.data(); }

} // namespace

Follower::Follower(linkside::Estimator estimator, Settings settings)
    : estimator_(std::move(estimator)), settings_(settings) {
    // A velocity observer of a rigid robot reads positions of links, which are then those of the motors.
    const char *const positions = estimator_.width("theta") > 0 ? "theta" : "q";
    names_ = estimator_.names(positions);
    positions_.resize(estimator_.width(positions));
    velocities_.resize(estimator_.width("dtheta"));
    efforts_.resize(estimator_.width("tau"));
    acceleration_channels_ = channels("acceleration", "_", 0);
    rate_channels_ = channels("rate", "_w", 3);
    accelerations_.resize(acceleration_channels_.size());
    rates_.resize(rate_channels_.size());
    waiting_.resize(sensors_.size());
    held_.resize(sensors_.size(), {LONG_AGO, {}});

    (positions[0] == 't' ? sample_.theta : sample_.q) = pointer(positions_);
    sample_.dtheta = pointer(velocities_);
    sample_.tau = pointer(efforts_);
    sample_.acceleration = pointer(accelerations_);
    sample_.rate = pointer(rates_);
}

/// Channels are called `<sensor>_x` or `<sensor>_wx`.
std::vector<Follower::Channel> Follower::channels(
    const char *signal, const std::string &before_axis, std::size_t first) {
    std::vector<Channel> found;
    for (const std::string &name : estimator_.names(signal)) {
        const std::string sensor = name.substr(0, name.size() - before_axis.size() - 1);
        auto at = std::find(sensors_.begin(), sensors_.end(), sensor);
        if (at == sensors_.end()) {
            at = sensors_.insert(at, sensor);
        }
        const auto axis = static_cast<std::size_t>(name.back() - 'x');
        found.push_back({static_cast<std::size_t>(at - sensors_.begin()), first + axis});
    }
    return found;
}

bool Follower::imu(const std::string &sensor, const ImuReading &reading) {
    const auto at = std::find(sensors_.begin(), sensors_.end(), sensor);
    if (at == sensors_.end()) {
        return false;
    }
    std::deque<ImuReading> &queue = waiting_[static_cast<std::size_t>(at - sensors_.begin())];
    if (queue.size() == MOST_WAITING) {
        queue.pop_front();
    }
    queue.push_back(reading);
    return true;
}

Outcome Follower::joints(const JointReadings &readings) {
    const double dt = running_ ? seconds(readings.stamp - last_) : 0.0;
    if (!running_ || std::abs(dt) > settings_.longest_gap) {
        start(readings.stamp);
        return Outcome::Started;
    }
    const double period = estimator_.period();
    const long periods = period > 0.0 ? std::lround(dt / period) : 1;
    if (dt <= 0.0 || periods < 1) {
        ++counts_.early;
        return Outcome::Early;
    }
    last_ = readings.stamp;
    if (periods > 1) {
        if (const Outcome outcome = bridged(periods - 1); outcome != Outcome::Estimated) {
            return outcome;
        }
    }
    order(readings.names);
    put(readings.position, positions_);
    put(readings.velocity, velocities_);
    put(readings.effort, efforts_);
    take_imus(readings.stamp);
    return step(dt);
}

void Follower::start(std::int64_t stamp) {
    estimator_.reset();
    if (stamp < last_) { // the clock stepped back: what waits is of another time
        for (std::deque<ImuReading> &queue : waiting_) {
            queue.clear();
        }
    }
    std::fill(held_.begin(), held_.end(), ImuReading{LONG_AGO, {}});
    last_ = stamp;
    running_ = true;
    ++counts_.started;
}

/// Finds the joints in a message; messages of one sender have them in one order.
void Follower::order(const std::vector<std::string> &names) {
    if (names == seen_) {
        return;
    }
    seen_ = names;
    places_.assign(names_.size(), NOWHERE);
    for (std::size_t joint = 0; joint < names_.size(); ++joint) {
        const auto at = std::find(names.begin(), names.end(), names_[joint]);
        if (at != names.end()) {
            places_[joint] = static_cast<std::size_t>(at - names.begin());
        }
    }
}

void Follower::put(const std::vector<double> &readings, std::vector<double> &signal) const {
    for (std::size_t joint = 0; joint < signal.size(); ++joint) {
        signal[joint] = places_[joint] < readings.size() ? readings[places_[joint]] : MISSING;
    }
}

void Follower::take_imus(std::int64_t stamp) {
    const bool holds = estimator_.period() > 0.0;
    for (std::size_t sensor = 0; sensor < sensors_.size(); ++sensor) {
        std::deque<ImuReading> &queue = waiting_[sensor];
        bool fresh = false;
        while (!queue.empty() && queue.front().stamp <= stamp) {
            held_[sensor] = queue.front();
            queue.pop_front();
            fresh = true;
        }
        if (!(fresh || holds) || seconds(stamp - held_[sensor].stamp) > settings_.longest_hold) {
            held_[sensor].values.fill(MISSING);
            ++counts_.without_imu;
        }
    }
    for (std::size_t i = 0; i < accelerations_.size(); ++i) {
        accelerations_[i] = held_[acceleration_channels_[i].sensor].values[acceleration_channels_[i].component];
    }
    for (std::size_t i = 0; i < rates_.size(); ++i) {
        rates_[i] = held_[rate_channels_[i].sensor].values[rate_channels_[i].component];
    }
}

/// Steps through samples that did not come: no positions, torques and accelerations as they last were.
Outcome Follower::bridged(long periods) {
    std::fill(positions_.begin(), positions_.end(), MISSING);
    for (; periods > 0; --periods) {
        if (const Outcome outcome = step(estimator_.period()); outcome != Outcome::Estimated) {
            return outcome;
        }
        --counts_.estimated;
        ++counts_.bridged;
    }
    return Outcome::Estimated;
}

Outcome Follower::step(double dt) {
    sample_.dt = dt;
    switch (estimator_.try_step(sample_)) {
    case LINKSIDE_OK:
        ++counts_.estimated;
        counts_.contradicted += (estimator_.status() & LINKSIDE_CONTRADICTED) != 0;
        return Outcome::Estimated;
    case LINKSIDE_LOST:
        ++counts_.lost;
        return Outcome::Lost;
    default:
        ++counts_.refused;
        return Outcome::Refused;
    }
}

std::vector<std::string> words(std::uint8_t status) {
    static const std::pair<std::uint8_t, const char *> meanings[] = {
        {LINKSIDE_DAMPED, "near a singular posture"},
        {LINKSIDE_BRIDGED, "a reading was missing"},
        {LINKSIDE_UNSEEN, "some accelerations were not seen"},
        {LINKSIDE_GATED, "an outlier was left out"},
        {LINKSIDE_PREDICTED, "no reading was used"},
        {LINKSIDE_UNWRAPPED, "an encoder wrapped"},
        {LINKSIDE_CONTRADICTED, "readings contradict the model"},
        {LINKSIDE_FAULTY, "one channel contradicts all others"},
    };
    std::vector<std::string> found;
    for (const auto &[bit, meaning] : meanings) {
        if (status & bit) {
            found.emplace_back(meaning);
        }
    }
    return found;
}

} // namespace linkside_ros
