// linkside_ros/follow: JointState and Imu in, the links' state and diagnostics out.

#include <linkside_ros/follower.hpp>

#include <diagnostic_msgs/msg/diagnostic_array.hpp>
#include <rclcpp/rclcpp.hpp>
#include <sensor_msgs/msg/imu.hpp>
#include <sensor_msgs/msg/joint_state.hpp>

#include <chrono>
#include <memory>
#include <string>
#include <vector>

namespace linkside_ros {

using diagnostic_msgs::msg::DiagnosticArray;
using diagnostic_msgs::msg::DiagnosticStatus;
using diagnostic_msgs::msg::KeyValue;
using sensor_msgs::msg::Imu;
using sensor_msgs::msg::JointState;

std::int64_t stamp(const std_msgs::msg::Header &header) { return rclcpp::Time(header.stamp).nanoseconds(); }

class FollowNode : public rclcpp::Node {
public:
    FollowNode()
        : Node("linkside"), follower_(linkside::Estimator(declare_parameter<std::string>("estimator")), settings()),
          q_(follower_.estimator().values("q")), dq_(follower_.estimator().values("dq")) {
        const rclcpp::SensorDataQoS qos;
        links_ = create_publisher<JointState>("~/links", qos);
        if (follower_.estimator().states() > 0) {
            uncertainty_ = create_publisher<JointState>("~/uncertainty", qos);
        }
        diagnostics_ = create_publisher<DiagnosticArray>("/diagnostics", 10);
        joints_ = create_subscription<JointState>(
            declare_parameter("joints", "/joint_states"), qos, [this](const JointState &message) { joints(message); });
        for (const std::string &sensor : follower_.sensors()) {
            const auto topic = declare_parameter("imu." + sensor, "/" + sensor);
            imus_.push_back(create_subscription<Imu>(
                topic, qos, [this, sensor](const Imu &message) { imu(sensor, message); }));
            RCLCPP_INFO(get_logger(), "%s is read from %s", sensor.c_str(), topic.c_str());
        }
        timer_ = create_wall_timer(std::chrono::seconds(1), [this] { report(); });
    }

private:
    Settings settings() {
        Settings settings;
        settings.longest_gap = declare_parameter("longest_gap", settings.longest_gap);
        settings.longest_hold = declare_parameter("longest_hold", settings.longest_hold);
        return settings;
    }

    void imu(const std::string &sensor, const Imu &message) {
        const auto &a = message.linear_acceleration;
        const auto &w = message.angular_velocity;
        follower_.imu(sensor, {stamp(message.header), {a.x, a.y, a.z, w.x, w.y, w.z}});
    }

    void joints(const JointState &message) {
        const Outcome outcome = follower_.joints(
            {stamp(message.header), message.name, message.position, message.velocity, message.effort});
        if (outcome == Outcome::Refused || outcome == Outcome::Lost) {
            RCLCPP_WARN_THROTTLE(get_logger(), *get_clock(), 1000, "%s", follower_.estimator().error());
        }
        if (outcome != Outcome::Estimated) {
            return;
        }
        links_->publish(state(message, q_, &dq_));
        if (uncertainty_) {
            uncertainty_->publish(state(message, follower_.estimator().values("q_std"), nullptr));
        }
    }

    JointState state(const JointState &message, const linkside::Values &position, const linkside::Values *velocity) {
        JointState out;
        out.header = message.header;
        out.name = follower_.names();
        out.position.assign(position.begin(), position.end());
        if (velocity != nullptr) {
            out.velocity.assign(velocity->begin(), velocity->end());
        }
        return out;
    }

    /// Once a second: whether the estimate of that second is to be used.
    void report() {
        const Counts now = follower_.counts();
        const std::uint64_t estimated = now.estimated - before_.estimated;
        const std::uint64_t contradicted = now.contradicted - before_.contradicted;
        DiagnosticStatus status;
        status.name = "linkside: " + follower_.estimator().method();
        status.hardware_id = "linkside";
        if (estimated == 0) {
            status.level = DiagnosticStatus::STALE;
            status.message = "no estimate in the last second";
        } else if (contradicted > 0) {
            status.level = DiagnosticStatus::ERROR;
            status.message = "readings contradict the model: do not use this estimate";
        } else if (now.refused != before_.refused || now.lost != before_.lost) {
            status.level = DiagnosticStatus::WARN;
            status.message = follower_.estimator().error();
        } else {
            status.level = DiagnosticStatus::OK;
            status.message = "estimated";
        }
        for (const std::string &meaning : words(follower_.estimator().status())) {
            status.values.push_back(value("last sample", meaning));
        }
        status.values.push_back(value("estimated", std::to_string(estimated)));
        status.values.push_back(value("contradicted", std::to_string(contradicted)));
        status.values.push_back(value("refused", std::to_string(now.refused - before_.refused)));
        status.values.push_back(value("lost", std::to_string(now.lost - before_.lost)));
        status.values.push_back(value("bridged", std::to_string(now.bridged - before_.bridged)));
        status.values.push_back(value("early", std::to_string(now.early - before_.early)));
        status.values.push_back(value("without IMU", std::to_string(now.without_imu - before_.without_imu)));
        status.values.push_back(value("starts in all", std::to_string(now.started)));
        before_ = now;
        DiagnosticArray array;
        array.header.stamp = this->now();
        array.status.push_back(std::move(status));
        diagnostics_->publish(array);
    }

    static KeyValue value(const std::string &key, const std::string &value) {
        KeyValue out;
        out.key = key;
        out.value = value;
        return out;
    }

    Follower follower_;
    linkside::Values q_, dq_;
    Counts before_;
    rclcpp::Publisher<JointState>::SharedPtr links_, uncertainty_;
    rclcpp::Publisher<DiagnosticArray>::SharedPtr diagnostics_;
    rclcpp::Subscription<JointState>::SharedPtr joints_;
    std::vector<rclcpp::Subscription<Imu>::SharedPtr> imus_;
    rclcpp::TimerBase::SharedPtr timer_;
};

} // namespace linkside_ros

int main(int count, char **arguments) {
    rclcpp::init(count, arguments);
    try {
        rclcpp::spin(std::make_shared<linkside_ros::FollowNode>());
    } catch (const std::exception &error) {
        RCLCPP_FATAL(rclcpp::get_logger("linkside"), "%s", error.what());
        rclcpp::shutdown();
        return 1;
    }
    rclcpp::shutdown();
}
