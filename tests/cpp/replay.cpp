// Feeds messages, a line each, to the follower of the ROS node, and writes each outcome with the estimate:
//
//     replay robot.lsr < messages > estimates
//
//     joints STAMP COUNT NAME POSITION VELOCITY EFFORT …
//     imu SENSOR STAMP AX AY AZ WX WY WZ

#include <linkside_ros/follower.hpp>

#include <cstdio>
#include <iostream>
#include <sstream>

namespace {

double number(std::istream &words) { // operator>> does not read nan
    std::string word;
    words >> word;
    return std::stod(word);
}

void joints(std::istream &words, linkside_ros::Follower &follower) {
    std::int64_t stamp = 0;
    std::size_t count = 0;
    words >> stamp >> count;
    std::vector<std::string> names(count);
    std::vector<double> position(count), velocity(count), effort(count);
    for (std::size_t i = 0; i < count; ++i) {
        words >> names[i];
        position[i] = number(words);
        velocity[i] = number(words);
        effort[i] = number(words);
    }
    const auto outcome = follower.joints({stamp, names, position, velocity, effort});
    std::printf("%d %d", static_cast<int>(outcome), follower.estimator().status());
    for (const double q : follower.estimator().values("q")) {
        std::printf(" %.17g", q);
    }
    std::printf("\n");
}

bool imu(std::istream &words, linkside_ros::Follower &follower) {
    std::string sensor;
    linkside_ros::ImuReading reading = {};
    words >> sensor >> reading.stamp;
    for (double &value : reading.values) {
        value = number(words);
    }
    return follower.imu(sensor, reading);
}

} // namespace

int main(int count, char **arguments) {
    if (count != 2) {
        return 2;
    }
    try {
        linkside_ros::Follower follower{linkside::Estimator(arguments[1])};
        std::string line, kind;
        while (std::getline(std::cin, line)) {
            std::istringstream words(line);
            words >> kind;
            if (kind == "joints") {
                joints(words, follower);
            } else if (!imu(words, follower)) {
                std::printf("no such sensor\n");
            }
        }
        const auto &counts = follower.counts();
        std::fprintf(stderr, "%llu %llu %llu %llu\n", static_cast<unsigned long long>(counts.estimated),
            static_cast<unsigned long long>(counts.started), static_cast<unsigned long long>(counts.early),
            static_cast<unsigned long long>(counts.bridged));
    } catch (const std::exception &error) {
        std::cerr << error.what() << '\n';
        return 1;
    }
}
