// Runs the example's controller as ros2_control would: joint states from stdin, torques to stdout, a row each.
#include <cstdio>

#include "carry_controller.hpp"

int main()
{
    carry::CarryController controller;
    if (controller.on_init() != controller_interface::CallbackReturn::SUCCESS) return 1;
    if (controller.on_configure({}) != controller_interface::CallbackReturn::FAILURE) return 2;  // no joints yet
    controller.get_node()->joints.value.assign(14, "joint");
    if (controller.on_configure({}) != controller_interface::CallbackReturn::SUCCESS) return 3;
    controller.command_interfaces_.resize(controller.command_interface_configuration().names.size());
    controller.state_interfaces_.resize(controller.state_interface_configuration().names.size());
    controller.on_activate({});
    for (double x; std::scanf("%lf", &x) == 1;) {
        controller.state_interfaces_[0].value = x;
        for (std::size_t k = 1; k < controller.state_interfaces_.size(); k++) {
            if (std::scanf("%lf", &controller.state_interfaces_[k].value) != 1) return 4;
        }
        if (controller.update({}, rclcpp::Duration(1e-3)) != controller_interface::return_type::OK) {
            std::printf("refused\n");
            continue;
        }
        for (const auto &command : controller.command_interfaces_) std::printf("%.17g ", command.value);
        std::printf("\n");
    }
    return 0;
}
