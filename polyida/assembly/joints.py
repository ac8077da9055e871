"""Joints on the values dz of the scene's points: phi, its derivatives, and the forces of the multipliers.

`dz = A u` are the displacements (2,) of the points and directions that joints hold on to. All of phi is a function of dz
and of the drives (value, first and second derivative of each motor's angle), zero where both are. The chain rule with the constant A gives everything
in q: `phi_q = phi_z A`.
"""

import numpy as np

from polyida.compiled import entry, part

LINEAR, MOTOR = 0, 1


@entry
def point_values(s, u, dz):
    """dz = A u, (points, 2)."""
    for f in range(dz.shape[0]):
        x = y = 0.0
        for k in range(s.point_ptr[f], s.point_ptr[f + 1]):
            w, i = s.point_weights[k], s.point_nodes[k]
            x += w * u[i, 0]
            y += w * u[i, 1]
        dz[f, 0] = x
        dz[f, 1] = y


@part
def spread(s, forces, r):
    """r += A^T forces."""
    for f in range(forces.shape[0]):
        x, y = forces[f, 0], forces[f, 1]
        if x != 0.0 or y != 0.0:
            for k in range(s.point_ptr[f], s.point_ptr[f + 1]):
                w, i = s.point_weights[k], s.point_nodes[k]
                r[i, 0] += w * x
                r[i, 1] += w * y


@part
def turned_sides(s, j, drives, dz):
    """(w, d): the direction of a turned by theta + theta0, and the direction of b."""
    a, b = s.joint_a[j], s.joint_b[j]
    ax, ay = s.joint_rest[j, 0, 0], s.joint_rest[j, 0, 1]
    bx, by = s.joint_rest[j, 1, 0], s.joint_rest[j, 1, 1]
    if a >= 0:
        ax, ay = ax + dz[a, 0], ay + dz[a, 1]
    if b >= 0:
        bx, by = bx + dz[b, 0], by + dz[b, 1]
    c, n = turn(s, j, drives)
    return c * ax - n * ay, n * ax + c * ay, bx, by


@part
def turn(s, j, drives):
    """Cosine and sine of theta + theta0."""
    theta = drives[s.joint_drive[j], 0]
    c0, n0 = s.joint_matrix[j, 0, 0], s.joint_matrix[j, 1, 0]
    c, n = np.cos(theta), np.sin(theta)
    return c * c0 - n * n0, n * c0 + c * n0


@entry
def motor_cosine(s, j, drives, dz):
    """Cosine of the angle error of motor j."""
    wx, wy, bx, by = turned_sides(s, j, drives, dz)
    return (wx * bx + wy * by) / np.sqrt((wx * wx + wy * wy) * (bx * bx + by * by))


@entry
def joint_forces(s, drives, dz, lam, phi, forces):
    """Fill phi; forces += phi_z^T lam. Returns the least cosine of a motor's angle error (1 without motors)."""
    least = 1.0
    for j in range(s.joint_kind.shape[0]):
        k, a, b = s.joint_row[j], s.joint_a[j], s.joint_b[j]
        if s.joint_kind[j] == LINEAR:
            _linear_forces(s, j, k, a, b, dz, lam, phi, forces)
            continue
        wx, wy, bx, by = turned_sides(s, j, drives, dz)
        phi[k] = wx * by - wy * bx
        least = min(least, motor_cosine(s, j, drives, dz))
        if a >= 0:
            c, n = turn(s, j, drives)
            forces[a, 0] += lam[k] * (c * by - n * bx)
            forces[a, 1] += lam[k] * (-n * by - c * bx)
        if b >= 0:
            forces[b, 0] -= lam[k] * wy
            forces[b, 1] += lam[k] * wx
    return least


@part
def _linear_forces(s, j, k, a, b, dz, lam, phi, forces):
    x = y = 0.0
    if a >= 0:
        x, y = dz[a, 0], dz[a, 1]
        forces[a, 0] += lam[k]
        forces[a, 1] += lam[k + 1]
    if b >= 0:
        q = s.joint_matrix[j]
        x -= q[0, 0] * dz[b, 0] + q[0, 1] * dz[b, 1]
        y -= q[1, 0] * dz[b, 0] + q[1, 1] * dz[b, 1]
        forces[b, 0] -= q[0, 0] * lam[k] + q[1, 0] * lam[k + 1]
        forces[b, 1] -= q[0, 1] * lam[k] + q[1, 1] * lam[k + 1]
    phi[k] = x
    phi[k + 1] = y


@entry
def joint_change(s, drives, gains, h, dz, vz, dd, dv, phi, rate):
    """Add to phi and rate = phi_z vz + phi_t what a step of h changes, to the round-off of its second differences
    alone.

    Points move by `h vz + dd`, their velocities by dv. drives: at the start of the step; gains (profiles, 3):
    increments of the angle, of the angle less h times its rate, of its rate. `phi += h rate + ...`: rate takes the
    place of terms that cancel in it.
    """
    for j in range(s.joint_kind.shape[0]):
        k, a, b = s.joint_row[j], s.joint_a[j], s.joint_b[j]
        if s.joint_kind[j] == MOTOR:
            motor_change(s, j, drives, gains[s.joint_drive[j]], h, dz, vz, dd, dv, phi, rate)
            continue
        for i in range(2):
            x = y = 0.0
            if a >= 0:
                x, y = dd[a, i], dv[a, i]
            if b >= 0:
                x -= s.joint_matrix[j, i, 0] * dd[b, 0] + s.joint_matrix[j, i, 1] * dd[b, 1]
                y -= s.joint_matrix[j, i, 0] * dv[b, 0] + s.joint_matrix[j, i, 1] * dv[b, 1]
            phi[k + i] += h * rate[k + i] + x
            rate[k + i] += y


@part
def motor_change(s, j, drives, gain, h, dz, vz, dd, dv, phi, rate):
    """`joint_change` of a motor: `phi = w x b`, `w = R a`, R turning by theta + theta0; J turns by a right angle.

    `dw = R (da + (cos g - 1) a1 + sin g J a1)`, of which `h R (va + theta' J a)` is in h rate; so is `h w x vb`.
    """
    a, b, k, speed = s.joint_a[j], s.joint_b[j], s.joint_row[j], drives[s.joint_drive[j], 1]
    wx, wy, bx, by = turned_sides(s, j, drives, dz)
    c, n = turn(s, j, drives)
    ax, ay = c * wx + n * wy, c * wy - n * wx
    vax, vay, ddax, dday, dvax, dvay = at_point(vz, dd, dv, a)
    vbx, vby, ddbx, ddby, dvbx, dvby = at_point(vz, dd, dv, b)
    dax, day, dbx, dby = h * vax + ddax, h * vay + dday, h * vbx + ddbx, h * vby + ddby
    x, y, g = ax + dax, ay + day, gain[0]
    less, sine, cubic = -2.0 * np.sin(0.5 * g) ** 2, np.sin(g), sine_less_angle(g)
    px, py = ddax - gain[1] * ay + less * x - cubic * y - g * day, dday + gain[1] * ax + less * y + cubic * x + g * dax
    dwx, dwy = rotated(c, n, dax + less * x - sine * y, day + less * y + sine * x)
    px, py = rotated(c, n, px, py)
    phi[k] += h * rate[k] + px * by - py * bx + wx * ddby - wy * ddbx + dwx * dby - dwy * dbx
    ux, uy = rotated(c, n, vax - speed * ay, vay + speed * ax)
    later = speed + gain[2]
    ex, ey = vax + dvax - later * y, vay + dvay + later * x
    fx, fy = rotated(c, n, less * ex - sine * ey + dvax - gain[2] * y - speed * day,
                     less * ey + sine * ex + dvay + gain[2] * x + speed * dax)
    rate[k] += fx * (by + dby) - fy * (bx + dbx) + ux * dby - uy * dbx
    rate[k] += dwx * (vby + dvby) - dwy * (vbx + dvbx) + wx * dvby - wy * dvbx


@part
def at_point(vz, dd, dv, a):
    """Velocity, second-order move and change of velocity of a point; zeros of the ground."""
    if a < 0:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    return vz[a, 0], vz[a, 1], dd[a, 0], dd[a, 1], dv[a, 0], dv[a, 1]


@part
def rotated(c, n, x, y):
    """(x, y) turned by the angle of cosine c and sine n."""
    return c * x - n * y, n * x + c * y


@part
def sine_less_angle(g):
    """sin g - g without cancellation."""
    if abs(g) < 0.05:
        return -g * g * g / 6.0 * (1.0 - g * g / 20.0 * (1.0 - g * g / 42.0))
    return np.sin(g) - g


@entry
def joint_jacobian(s, drives, dz, phi_z):
    """Fill phi_z (m, 2 points), dense."""
    phi_z[:] = 0.0
    for j in range(s.joint_kind.shape[0]):
        k, a, b = s.joint_row[j], s.joint_a[j], s.joint_b[j]
        if s.joint_kind[j] == LINEAR:
            if a >= 0:
                phi_z[k, 2 * a] = 1.0
                phi_z[k + 1, 2 * a + 1] = 1.0
            if b >= 0:
                for i in range(2):
                    for e in range(2):
                        phi_z[k + i, 2 * b + e] = -s.joint_matrix[j, i, e]
            continue
        wx, wy, bx, by = turned_sides(s, j, drives, dz)
        if a >= 0:
            c, n = turn(s, j, drives)
            phi_z[k, 2 * a] = c * by - n * bx
            phi_z[k, 2 * a + 1] = -n * by - c * bx
        if b >= 0:
            phi_z[k, 2 * b] = -wy
            phi_z[k, 2 * b + 1] = wx


@entry
def joint_curvature(s, drives, lam, curvature):
    """curvature += d(phi_z^T lam)/dz, (2 points, 2 points): lam R^T J between the two directions of a motor."""
    for j in range(s.joint_kind.shape[0]):
        a, b = s.joint_a[j], s.joint_b[j]
        if s.joint_kind[j] == MOTOR and a >= 0 and b >= 0:
            c, n = turn(s, j, drives)
            g = lam[s.joint_row[j]]
            block = ((-n * g, c * g), (-c * g, -n * g))
            for i in range(2):
                for e in range(2):
                    curvature[2 * a + i, 2 * b + e] += block[i][e]
                    curvature[2 * b + e, 2 * a + i] += block[i][e]


@entry
def joint_rates(s, drives, dz, vz, phi_t, bias):
    """Fill phi_t (m,) and the bias of the acceleration constraint `(phi_q v)_q v + 2 phi_qt v + phi_tt` (m,)."""
    phi_t[:] = 0.0
    bias[:] = 0.0
    for j in range(s.joint_kind.shape[0]):
        if s.joint_kind[j] != MOTOR:
            continue
        k, a, b = s.joint_row[j], s.joint_a[j], s.joint_b[j]
        wx, wy, bx, by = turned_sides(s, j, drives, dz)
        c, n = turn(s, j, drives)
        rate, second = drives[s.joint_drive[j], 1], drives[s.joint_drive[j], 2]
        ux = uy = dx = dy = 0.0
        if a >= 0:
            ux, uy = c * vz[a, 0] - n * vz[a, 1], n * vz[a, 0] + c * vz[a, 1]
        if b >= 0:
            dx, dy = vz[b, 0], vz[b, 1]
        along = wx * bx + wy * by
        phi_t[k] = -rate * along
        mixed = -rate * (ux * bx + uy * by + wx * dx + wy * dy)
        bias[k] = 2.0 * (ux * dy - uy * dx) + 2.0 * mixed - second * along - rate * rate * (wx * by - wy * bx)


@part
def joint_velocities(s, drives, dz, vz, rate):
    """rate += phi_z vz, (m,)."""
    for j in range(s.joint_kind.shape[0]):
        k, a, b = s.joint_row[j], s.joint_a[j], s.joint_b[j]
        if s.joint_kind[j] == LINEAR:
            for i in range(2):
                if a >= 0:
                    rate[k + i] += vz[a, i]
                if b >= 0:
                    rate[k + i] -= s.joint_matrix[j, i, 0] * vz[b, 0] + s.joint_matrix[j, i, 1] * vz[b, 1]
            continue
        wx, wy, bx, by = turned_sides(s, j, drives, dz)
        c, n = turn(s, j, drives)
        if a >= 0:
            rate[k] += (c * vz[a, 0] - n * vz[a, 1]) * by - (n * vz[a, 0] + c * vz[a, 1]) * bx
        if b >= 0:
            rate[k] += wx * vz[b, 1] - wy * vz[b, 0]


@part
def joint_rate_jacobian(s, drives, dz, vz, rate_z):
    """Fill rate_z = d(phi_z vz + phi_t)/dz (m, 2 points), dense."""
    rate_z[:] = 0.0
    for j in range(s.joint_kind.shape[0]):
        if s.joint_kind[j] != MOTOR:
            continue
        k, a, b = s.joint_row[j], s.joint_a[j], s.joint_b[j]
        wx, wy, bx, by = turned_sides(s, j, drives, dz)
        c, n = turn(s, j, drives)
        rate = drives[s.joint_drive[j], 1]
        if a >= 0:
            dx, dy = -rate * bx, -rate * by
            if b >= 0:
                dx, dy = dx + vz[b, 1], dy - vz[b, 0]
            rate_z[k, 2 * a] = c * dx + n * dy
            rate_z[k, 2 * a + 1] = -n * dx + c * dy
        if b >= 0:
            ux = uy = 0.0
            if a >= 0:
                ux, uy = c * vz[a, 0] - n * vz[a, 1], n * vz[a, 0] + c * vz[a, 1]
            rate_z[k, 2 * b] = -uy - rate * wx
            rate_z[k, 2 * b + 1] = ux - rate * wy
