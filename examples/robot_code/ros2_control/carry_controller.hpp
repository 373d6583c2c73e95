// A ros2_control controller (Humble, Jazzy): both arms' joint positions and velocities in, their torques out.

#pragma once

#include <memory>
#include <string>
#include <vector>

#include "controller_interface/controller_interface.hpp"
#include "pandas.hpp"

namespace carry {

class CarryController : public controller_interface::ControllerInterface
{
public:
    controller_interface::CallbackReturn on_init() override;
    controller_interface::InterfaceConfiguration command_interface_configuration() const override;
    controller_interface::InterfaceConfiguration state_interface_configuration() const override;
    controller_interface::CallbackReturn on_configure(const rclcpp_lifecycle::State &before) override;
    controller_interface::CallbackReturn on_activate(const rclcpp_lifecycle::State &before) override;
    controller_interface::CallbackReturn on_deactivate(const rclcpp_lifecycle::State &before) override;
    controller_interface::return_type update(const rclcpp::Time &time, const rclcpp::Duration &period) override;

private:
    void observe();

    // Machine code and its memory: nothing is allocated while the controller runs.
    pandas::Control control_;
    pandas::TipPoses tips_;
    pandas::Jacobian jacobian_;
    std::vector<std::string> joints_;  // left arm, then right, base to tip
    double elapsed_ = 0.0;             // s since activation, from which the path is run
};

}  // namespace carry
