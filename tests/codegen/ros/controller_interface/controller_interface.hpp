// Stands for ros2_control in tests: as much of its interface as a controller of joint torques asks for.
#pragma once

#include <memory>
#include <string>
#include <type_traits>
#include <vector>

namespace rclcpp {
class Time {};
class Duration {
public:
    explicit Duration(double s) : s_(s) {}
    double seconds() const { return s_; }
private:
    double s_;
};
}  // namespace rclcpp

namespace rclcpp_lifecycle {
class State {};
class Parameter {
public:
    std::vector<std::string> value;
    std::vector<std::string> as_string_array() const { return value; }
};
class LifecycleNode {
public:
    Parameter joints;
    Parameter get_parameter(const std::string &) const { return joints; }
};
}  // namespace rclcpp_lifecycle

namespace controller_interface {
enum class CallbackReturn { SUCCESS, FAILURE, ERROR };
enum class return_type { OK, ERROR };
enum class interface_configuration_type { ALL, INDIVIDUAL, NONE };
struct InterfaceConfiguration {
    interface_configuration_type type;
    std::vector<std::string> names;
};
class Loaned {
public:
    double value = 0.0;
    double get_value() const { return value; }
    [[nodiscard]] bool set_value(double x) { value = x; return true; }
};
class ControllerInterface {
public:
    virtual ~ControllerInterface() = default;
    virtual CallbackReturn on_init() = 0;
    virtual InterfaceConfiguration command_interface_configuration() const = 0;
    virtual InterfaceConfiguration state_interface_configuration() const = 0;
    virtual CallbackReturn on_configure(const rclcpp_lifecycle::State &) { return CallbackReturn::SUCCESS; }
    virtual CallbackReturn on_activate(const rclcpp_lifecycle::State &) { return CallbackReturn::SUCCESS; }
    virtual CallbackReturn on_deactivate(const rclcpp_lifecycle::State &) { return CallbackReturn::SUCCESS; }
    virtual return_type update(const rclcpp::Time &, const rclcpp::Duration &) = 0;
    std::shared_ptr<rclcpp_lifecycle::LifecycleNode> get_node() const { return node_; }
    std::vector<Loaned> command_interfaces_, state_interfaces_;
protected:
    template <typename T> void auto_declare(const std::string &, const T &) {}
private:
    std::shared_ptr<rclcpp_lifecycle::LifecycleNode> node_ = std::make_shared<rclcpp_lifecycle::LifecycleNode>();
};
}  // namespace controller_interface
