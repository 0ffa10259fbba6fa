// A controller's loop: an estimator from a file that `linkside compile` has written, fed with a log in CSV.
//
//     controller robot.lsr log.csv estimate.csv
//
// A real controller has the signals from its drives instead; what is in the loop stays as it is.

#include <linkside.hpp>

#include <cstdio>
#include <fstream>
#include <iostream>
#include <map>
#include <sstream>
#include <string>
#include <vector>

namespace {

/// Columns of numbers by name; an empty cell is a reading that is missing, NaN.
using Table = std::map<std::string, std::vector<double>>;

Table read(const char *path) {
    std::ifstream file(path);
    std::string line, cell;
    std::vector<std::string> names;
    if (!std::getline(file, line)) {
        throw std::runtime_error(std::string(path) + ": no header");
    }
    for (std::istringstream cells(line); std::getline(cells, cell, ',');) {
        names.push_back(cell.front() == '"' ? cell.substr(1, cell.size() - 2) : cell);
    }
    Table table;
    while (std::getline(file, line)) {
        std::istringstream cells(line);
        for (const std::string &name : names) {
            cell.clear();
            std::getline(cells, cell, ',');
            table[name].push_back(cell.empty() ? std::stod("nan") : std::stod(cell));
        }
    }
    return table;
}

/// The columns of a signal, in the order in which a sample has them; none that the log does not have.
std::vector<const double *> columns(const Table &table, const linkside::Estimator &estimator, const std::string &signal) {
    std::vector<const double *> found;
    for (const std::string &name : estimator.names(signal.c_str())) {
        const bool of_sensor = signal == "acceleration" || signal == "rate";
        const auto column = table.find(of_sensor ? name : signal + "_" + name);
        if (column == table.end()) {
            return {};
        }
        found.push_back(column->second.data());
    }
    return found;
}

void run(const char *robot, const char *log, const char *out) {
    linkside::Estimator estimator(robot);
    const Table table = read(log);
    const std::vector<double> &t = table.at("t");

    // One buffer a signal; a sample points to those that the log has.
    const char *const signals[] = {"theta", "dtheta", "tau", "acceleration"};
    std::vector<const double *> sources[4];
    std::vector<double> buffers[4];
    LinksideSample sample = {};
    const double **const pointers[] = {&sample.theta, &sample.dtheta, &sample.tau, &sample.acceleration};
    for (int s = 0; s < 4; ++s) {
        sources[s] = columns(table, estimator, signals[s]);
        buffers[s].resize(sources[s].size());
        *pointers[s] = buffers[s].empty() ? nullptr : buffers[s].data();
    }

    const linkside::Values q = estimator.values("q"), dq = estimator.values("dq");
    std::vector<double> rows;
    rows.reserve(t.size() * (q.size() + dq.size() + 1));

    for (size_t i = 0; i < t.size(); ++i) {
        sample.dt = i == 0 ? t[1] - t[0] : t[i] - t[i - 1];
        for (int s = 0; s < 4; ++s) {
            for (size_t j = 0; j < buffers[s].size(); ++j) {
                buffers[s][j] = sources[s][j][i];
            }
        }
        if (estimator.try_step(sample) != LINKSIDE_OK) {
            throw std::runtime_error("sample " + std::to_string(i) + ": " + estimator.error());
        }
        // A controller acts on q and dq here, unless `status` has LINKSIDE_CONTRADICTED.
        rows.insert(rows.end(), q.begin(), q.end());
        rows.insert(rows.end(), dq.begin(), dq.end());
        rows.push_back(estimator.status());
    }

    std::FILE *file = std::fopen(out, "w");
    if (file == nullptr) {
        throw std::runtime_error(std::string(out) + ": cannot be written");
    }
    const size_t width = q.size() + dq.size() + 1;
    for (size_t i = 0; i < rows.size(); ++i) {
        std::fprintf(file, "%.17g%c", rows[i], (i + 1) % width == 0 ? '\n' : ',');
    }
    std::fclose(file);
}

} // namespace

int main(int count, char **arguments) {
    if (count != 4) {
        std::cerr << "usage: controller robot.lsr log.csv estimate.csv\n";
        return 2;
    }
    try {
        run(arguments[1], arguments[2], arguments[3]);
    } catch (const std::exception &error) {
        std::cerr << error.what() << '\n';
        return 1;
    }
}
