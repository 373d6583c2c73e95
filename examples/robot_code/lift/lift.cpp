// Two arms lift a box by friction for one second, 1,000 times a second. The law is written here: it says how the box
// shall accelerate, and `distribute` which torques do it within limits and with the least effort. The scene's own law
// is asked beside it. Nothing asks for memory after it has started.

#include <algorithm>
#include <array>
#include <chrono>
#include <cstdio>
#include <thread>

#include "lift.hpp"

namespace {

using Clock = std::chrono::steady_clock;
using Microseconds = std::chrono::duration<double, std::micro>;

constexpr double sample_time = 1e-3;  // s
constexpr int samples = 1000;
constexpr double height = 0.2, duration = 0.8;       // m, s: of the lift
constexpr double stiffness = 100.0, damping = 20.0;  // 1/s^2, 1/s: of the box's errors
constexpr double calm = 10.0, pull = 25.0;           // 1/s, 1/s^2: of the joints that the box leaves free

lift::Step plant;
lift::Distribute torques;
lift::Control law;
std::array<double, 3> start;    // where the box was [m]
std::array<double, 14> resting;  // and the joints

// How the box shall accelerate along its way up, from rest to rest: s = 10 x^3 - 15 x^4 + 6 x^5.
void want(double t)
{
    const double x = std::min(t / duration, 1.0), rest = 1.0 - x;
    const double s = x * x * x * (10.0 - 15.0 * x + 6.0 * x * x);
    const double rate = 30.0 * x * x * rest * rest / duration;
    const double second = 60.0 * x * rest * (1.0 - 2.0 * x) / duration / duration;
    const auto pose = plant.object_pose();
    const auto twist = plant.object_twist();
    auto wanted = torques.acceleration();
    for (int k = 0; k < 3; k++) {
        const double up = k == 2 ? height : 0.0;
        wanted[k] = -damping * twist[k];
        wanted[3 + k] = up * second + damping * (up * rate - twist[3 + k]) + stiffness * (start[k] + up * s - pose[4 + k]);
    }
    for (int j = 0; j < 14; j++) {
        torques.wished_qdd()[j] = -calm * plant.qd()[j] + pull * (resting[j] - plant.q()[j]);
    }
}

template <class Function>
void measure(Function &f)
{
    std::copy(plant.q().begin(), plant.q().end(), f.q().begin());
    std::copy(plant.qd().begin(), plant.qd().end(), f.qd().begin());
    std::copy(plant.object_pose().begin(), plant.object_pose().end(), f.object_pose().begin());
    std::copy(plant.object_twist().begin(), plant.object_twist().end(), f.object_twist().begin());
}

template <class Call>
double timed(Call call)
{
    const auto begin = Clock::now();
    call();
    return Microseconds(Clock::now() - begin).count();
}

void report(const char *what, std::array<double, samples> &times)
{
    std::sort(times.begin(), times.end());
    std::printf("%s: median %.1f us, at most %.1f us\n", what, times[samples / 2], times[samples - 1]);
}

}  // namespace

int main()
{
    static std::array<double, samples> asked, own;
    double violation = 0.0, residual = 0.0;
    int late = 0;
    std::copy(plant.object_pose().begin() + 4, plant.object_pose().end(), start.begin());
    std::copy(plant.q().begin(), plant.q().end(), resting.begin());
    plant.step()[0] = sample_time;
    torques.effort_share()[0] = 0.8;
    std::fill(torques.demanded_margin().begin(), torques.demanded_margin().end(), 2.0);  // N
    auto next = Clock::now();
    for (int k = 0; k < samples; k++) {
        std::this_thread::sleep_until(next);
        next += std::chrono::microseconds(1000);
        measure(torques);
        want(k * sample_time);
        asked[k] = timed([] {
            torques.prepare();  // wished_qdd is a parameter, and has changed
            torques();
        });
        measure(law);
        law.t()[0] = k * sample_time;
        own[k] = timed([] { law(); });
        std::copy(law.kept().begin(), law.kept().end(), law.memory().begin());
        late += Clock::now() > next;
        violation = std::max(violation, torques.violation()[0]);
        residual = std::max(residual, torques.residual()[0]);
        std::copy(torques.tau().begin(), torques.tau().end(), plant.tau().begin());
        if (const auto status = plant(); status != LIFT_STEP_RUNNING) {
            std::fprintf(stderr, "no step at %g s: status %d\n", k * sample_time, static_cast<int>(status));
            return 1;
        }
    }
    std::printf("the box is at %.4f m, limits passed by at most %.1e N, residual %.1e\n", plant.object_pose()[6], violation,
                residual);
    report("distribute", asked);
    report("the scene's law", own);
    std::printf("samples of 1 ms missed: %d of %d\nexactly:", late, samples);
    for (const double x : plant.object_pose()) {
        std::printf(" %a", x);
    }
    std::printf("\n");
    return 0;
}
