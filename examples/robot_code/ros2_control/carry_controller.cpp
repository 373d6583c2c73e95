#include "carry_controller.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "../object_state.hpp"
#include "pluginlib/class_list_macros.hpp"

namespace carry {

using controller_interface::CallbackReturn;
using controller_interface::InterfaceConfiguration;
using controller_interface::interface_configuration_type;
using controller_interface::return_type;

namespace {

constexpr std::size_t joint_count = decltype(std::declval<pandas::Control &>().q())::size();
constexpr std::size_t left_joints = 7;

// The left hand's contact frame on the box, as examples/two_pandas.toml has it.
constexpr Frame left_grasp{{{{0.0, 0.0, 1.0}, {-1.0, 0.0, 0.0}, {0.0, -1.0, 0.0}}}, {-0.15, 0.0, 0.0}};

}  // namespace

CallbackReturn CarryController::on_init()
{
    auto_declare<std::vector<std::string>>("joints", {});
    return CallbackReturn::SUCCESS;
}

InterfaceConfiguration CarryController::command_interface_configuration() const
{
    InterfaceConfiguration found{interface_configuration_type::INDIVIDUAL, {}};
    for (const auto &joint : joints_) {
        found.names.push_back(joint + "/effort");
    }
    return found;
}

InterfaceConfiguration CarryController::state_interface_configuration() const
{
    InterfaceConfiguration found{interface_configuration_type::INDIVIDUAL, {}};
    for (const char *quantity : {"/position", "/velocity"}) {
        for (const auto &joint : joints_) {
            found.names.push_back(joint + quantity);
        }
    }
    return found;
}

CallbackReturn CarryController::on_configure(const rclcpp_lifecycle::State &)
{
    joints_ = get_node()->get_parameter("joints").as_string_array();
    return joints_.size() == joint_count ? CallbackReturn::SUCCESS : CallbackReturn::FAILURE;
}

CallbackReturn CarryController::on_activate(const rclcpp_lifecycle::State &)
{
    elapsed_ = 0.0;
    return CallbackReturn::SUCCESS;
}

CallbackReturn CarryController::on_deactivate(const rclcpp_lifecycle::State &)
{
    return CallbackReturn::SUCCESS;
}

// Bring the joints' state, and the box's that follows from the left arm's, to the law.
void CarryController::observe()
{
    for (std::size_t k = 0; k < joint_count; k++) {
        control_.q()[k] = state_interfaces_[k].get_value();
        control_.qd()[k] = state_interfaces_[joint_count + k].get_value();
    }
    std::copy(control_.q().begin(), control_.q().end(), tips_.q().begin());
    std::copy(control_.q().begin(), control_.q().end(), jacobian_.q().begin());
    tips_();
    jacobian_();
    const auto frame = tips_.frame();  // of the left arm first: axes by rows, then origin
    Frame tip{};
    for (std::size_t i = 0; i < 3; i++) {
        std::copy_n(frame.begin() + 3 * i, 3, tip.R[i].begin());
    }
    std::copy_n(frame.begin() + 9, 3, tip.p.begin());
    std::array<double, 6> moves{};
    for (std::size_t i = 0; i < 6; i++) {
        for (std::size_t k = 0; k < left_joints; k++) {
            moves[i] += jacobian_.jacobian()[left_joints * i + k] * control_.qd()[k];
        }
    }
    const Frame object = object_frame(tip, left_grasp);
    const auto turn = quaternion(object.R);
    const auto twist = object_twist(moves, tip.p, object.p);
    std::copy(turn.begin(), turn.end(), control_.object_pose().begin());
    std::copy(object.p.begin(), object.p.end(), control_.object_pose().begin() + 4);
    std::copy(twist.begin(), twist.end(), control_.object_twist().begin());
}

return_type CarryController::update(const rclcpp::Time &, const rclcpp::Duration &period)
{
    observe();
    control_.t()[0] = elapsed_;
    control_();
    const auto tau = control_.tau();
    if (!std::all_of(tau.begin(), tau.end(), [](double x) { return std::isfinite(x); })) {
        return return_type::ERROR;  // an invalid state: the controller manager stops us before a torque is sent
    }
    for (std::size_t k = 0; k < joint_count; k++) {
        static_cast<void>(command_interfaces_[k].set_value(tau[k]));
    }
    elapsed_ += period.seconds();
    return return_type::OK;
}

}  // namespace carry

PLUGINLIB_EXPORT_CLASS(carry::CarryController, controller_interface::ControllerInterface)
