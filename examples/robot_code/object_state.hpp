// Where the box is and how it moves, from the joints of the arm that holds it rigidly: what `control` asks for.

#pragma once

#include <array>
#include <cmath>
#include <cstddef>

namespace carry {

using Vector = std::array<double, 3>;
using Matrix = std::array<std::array<double, 3>, 3>;

// A frame: its axes to world axes, and its origin [m].
struct Frame {
    Matrix R;
    Vector p;
};

inline Vector cross(const Vector &a, const Vector &b)
{
    return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

// The object's frame when `tip` coincides with a contact frame that is at `grasp` in the object: tip grasp^-1.
inline Frame object_frame(const Frame &tip, const Frame &grasp)
{
    Frame object{};
    for (std::size_t i = 0; i < 3; i++) {
        for (std::size_t j = 0; j < 3; j++) {
            for (std::size_t k = 0; k < 3; k++) {
                object.R[i][j] += tip.R[i][k] * grasp.R[j][k];
            }
        }
    }
    for (std::size_t i = 0; i < 3; i++) {
        object.p[i] = tip.p[i];
        for (std::size_t k = 0; k < 3; k++) {
            object.p[i] -= object.R[i][k] * grasp.p[k];
        }
    }
    return object;
}

// The unit quaternion w, x, y, z of a rotation matrix, by its largest component.
inline std::array<double, 4> quaternion(const Matrix &R)
{
    const double trace = R[0][0] + R[1][1] + R[2][2];
    if (trace > 0.0) {
        const double s = 2.0 * std::sqrt(trace + 1.0);
        return {0.25 * s, (R[2][1] - R[1][2]) / s, (R[0][2] - R[2][0]) / s, (R[1][0] - R[0][1]) / s};
    }
    std::size_t i = R[1][1] > R[0][0] ? 1 : 0;
    i = R[2][2] > R[i][i] ? 2 : i;
    const std::size_t j = (i + 1) % 3, k = (i + 2) % 3;
    const double s = 2.0 * std::sqrt(1.0 + R[i][i] - R[j][j] - R[k][k]);
    std::array<double, 4> q{};
    q[0] = (R[k][j] - R[j][k]) / s;
    q[i + 1] = 0.25 * s;
    q[j + 1] = (R[j][i] + R[i][j]) / s;
    q[k + 1] = (R[k][i] + R[i][k]) / s;
    return q;
}

// The twist [omega; v] of the object's origin, which moves with the tip.
inline std::array<double, 6> object_twist(const std::array<double, 6> &tip, const Vector &tip_p, const Vector &object_p)
{
    const Vector omega{tip[0], tip[1], tip[2]};
    const Vector lever{object_p[0] - tip_p[0], object_p[1] - tip_p[1], object_p[2] - tip_p[2]};
    const Vector more = cross(omega, lever);
    return {tip[0], tip[1], tip[2], tip[3] + more[0], tip[4] + more[1], tip[5] + more[2]};
}

}  // namespace carry
