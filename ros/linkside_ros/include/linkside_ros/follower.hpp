// An estimator fed with messages: which reading belongs to which sample. Nothing here knows of ROS.

#ifndef LINKSIDE_ROS_FOLLOWER_HPP
#define LINKSIDE_ROS_FOLLOWER_HPP

#include <linkside.hpp>

#include <array>
#include <cstdint>
#include <deque>
#include <string>
#include <vector>

namespace linkside_ros {

/// A sensor_msgs/JointState; an empty array is a signal that is not there.
struct JointReadings {
    std::int64_t stamp; // ns
    const std::vector<std::string> &names;
    const std::vector<double> &position;
    const std::vector<double> &velocity;
    const std::vector<double> &effort;
};

/// A sensor_msgs/Imu: specific force x, y, z [m/s²], then angular rate [rad/s], in the sensor's axes.
struct ImuReading {
    std::int64_t stamp; // ns
    std::array<double, 6> values;
};

/// What became of joint readings.
enum class Outcome {
    Estimated,
    Started, // the first after a start or a gap: it says when the next one's time begins
    Early,   // not later than the one before: left out
    Refused, // the estimator says what is wrong with it
    Lost,    // absurd readings; the estimate starts again
};

struct Settings {
    double longest_gap = 0.1;  // s; after a longer one, or a step back of the clock, the estimate starts again
    double longest_hold = 0.02; // s; an IMU's reading that is older is missing
};

struct Counts {
    std::uint64_t estimated = 0, started = 0, early = 0, refused = 0, lost = 0, bridged = 0, without_imu = 0;
    std::uint64_t contradicted = 0;
};

/// Steps an estimator at each JointState, with the newest reading of each IMU up to then.
///
/// A filter takes an IMU's reading once: taken twice it would count as two. An observer, which has a period, holds it until
/// the next, and bridges joint readings that did not come.
class Follower {
public:
    explicit Follower(linkside::Estimator estimator, Settings settings = {});

    Outcome joints(const JointReadings &readings);

    /// Keeps a reading for the joint readings that follow; false where the estimator reads no such sensor.
    bool imu(const std::string &sensor, const ImuReading &reading);

    const linkside::Estimator &estimator() const noexcept { return estimator_; }
    const Counts &counts() const noexcept { return counts_; }
    const std::vector<std::string> &sensors() const noexcept { return sensors_; }
    const std::vector<std::string> &names() const noexcept { return names_; }

private:
    struct Channel {
        std::size_t sensor, component;
    };

    std::vector<Channel> channels(const char *signal, const std::string &before_axis, std::size_t first);
    void order(const std::vector<std::string> &names);
    void put(const std::vector<double> &readings, std::vector<double> &signal) const;
    void take_imus(std::int64_t stamp);
    void start(std::int64_t stamp);
    Outcome step(double dt);
    Outcome bridged(long periods);

    linkside::Estimator estimator_;
    Settings settings_;
    Counts counts_;
    std::vector<std::string> names_, sensors_, seen_;
    std::vector<std::size_t> places_; // where each joint is in a message
    std::vector<Channel> acceleration_channels_, rate_channels_;
    std::vector<double> positions_, velocities_, efforts_, accelerations_, rates_;
    std::vector<std::deque<ImuReading>> waiting_;
    std::vector<ImuReading> held_; // the last reading of each sensor that was taken
    std::int64_t last_ = 0;
    bool running_ = false;
    LinksideSample sample_ = {};
};

/// What a status says, in words.
std::vector<std::string> words(std::uint8_t status);

} // namespace linkside_ros

#endif
