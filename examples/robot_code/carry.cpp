// Two arms carry a box for two seconds: the scene's controller, asked once every millisecond, and a simulated plant.
// Both are machine code that `holdfast export-c` wrote; nothing here asks for memory after it has started.

#include <algorithm>
#include <chrono>
#include <cstdio>

#include "pandas.hpp"

namespace {

constexpr double sample_time = 1e-3;  // s
constexpr int samples = 2000;

pandas::Step plant;
pandas::Control control;

// One sample: the plant's state to the controller, its torques to the plant, and a step under them.
pandas_step_status sample(int k)
{
    control.t()[0] = k * sample_time;
    std::copy(plant.q().begin(), plant.q().end(), control.q().begin());
    std::copy(plant.qd().begin(), plant.qd().end(), control.qd().begin());
    std::copy(plant.object_pose().begin(), plant.object_pose().end(), control.object_pose().begin());
    std::copy(plant.object_twist().begin(), plant.object_twist().end(), control.object_twist().begin());
    control();
    std::copy(control.tau().begin(), control.tau().end(), plant.tau().begin());
    return plant();
}

}  // namespace

int main()
{
    plant.step()[0] = sample_time;
    const auto begin = std::chrono::steady_clock::now();
    for (int k = 0; k < samples; k++) {
        if (const auto status = sample(k); status != PANDAS_STEP_RUNNING) {
            std::fprintf(stderr, "no step at %g s: status %d\n", k * sample_time, static_cast<int>(status));
            return 1;
        }
        if (k % 400 == 399) {
            const auto at = plant.object_pose();
            std::printf("%4.1f s: the box is at %7.4f %7.4f %7.4f m\n", (k + 1) * sample_time, at[4], at[5], at[6]);
        }
    }
    const std::chrono::duration<double, std::micro> taken = std::chrono::steady_clock::now() - begin;
    std::printf("exactly:");
    for (const double x : plant.object_pose()) {
        std::printf(" %a", x);
    }
    std::printf("\nper sample, control and step: %.1f us\n", taken.count() / samples);
    return 0;
}
