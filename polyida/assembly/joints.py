"""Rows of phi and velocity rows as functions of the displacements dz of the points: values, derivatives, and the forces of the multipliers.

Joints hold on to points `z = rest + dz`, (2,), `dz = A u`. A row is `constant + L dz + sum f p(t) + sum R(theta) E . F`; p is a profile, the
shift of the row; E and F are vectors `rest + sum_j W_j dz_j`, W_j complex numbers (2,). By the chain rule with the constant A, `phi_q = phi_z A`.
`slopes` holds the entries of phi_z of row k at the components `2 point + axis` in `row_columns[row_start[k]:row_start[k + 1]]`.

A velocity row is `psi = constant + L z' + sum f p(t) + sum R(theta) E . F'`. It is treated as a row with phi = 0, the rate psi and the slopes
`W = d psi/dz'` in place of phi_z; it is not integrable, so that slopes and rate are not derivatives of phi.
"""

import numpy as np

from polyida.jit import entry, leaf, part, shared
from polyida.linear.dense import put, zero


@leaf
def point_value(links, moved, point):
    """The components (x, y) of `A moved` at a point: its displacement or velocity, if moved (pairs, 2) has those of the coordinates."""
    x = y = 0.0
    for k in range(links.point_ptr[point], links.point_ptr[point + 1]):
        c, n, i = links.point_weights[k, 0], links.point_weights[k, 1], links.point_nodes[k]
        x += c * moved[i, 0] - n * moved[i, 1]
        y += c * moved[i, 1] + n * moved[i, 0]
    return x, y


@entry
def point_values(links, moved, dz):
    """Overwrite dz (points, 2) with A moved, moved (pairs, 2): displacements of points from those of the coordinates, or velocities."""
    for f in range(dz.shape[0]):
        dz[f, 0], dz[f, 1] = point_value(links, moved, f)


@leaf
def spread_one(links, point, x, y, residual):
    """residual += A^T of the force (x, y) at a point."""
    for k in range(links.point_ptr[point], links.point_ptr[point + 1]):
        c, n, i = links.point_weights[k, 0], links.point_weights[k, 1], links.point_nodes[k]
        residual[i, 0] += c * x + n * y
        residual[i, 1] += c * y - n * x


@part
def spread(links, forces, residual):
    """Add the forces at the points of the joints to residual: `residual += A^T forces`."""
    for f in range(forces.shape[0]):
        x, y = forces[f, 0], forces[f, 1]
        if x != 0.0 or y != 0.0:
            spread_one(links, f, x, y, residual)


@leaf
def vector_change(links, vector, dz):
    """The change (x, y) of a vector of a row, `sum_j W_j dz_j`, at displacements dz of the points."""
    x = y = 0.0
    for k in range(links.vector_start[vector], links.vector_start[vector + 1]):
        p, c, n = links.vector_points[k], links.vector_weights[k, 0], links.vector_weights[k, 1]
        x += c * dz[p, 0] - n * dz[p, 1]
        y += n * dz[p, 0] + c * dz[p, 1]
    return x, y


@leaf
def rotated(cos, sin, x, y):
    """The vector (x, y) rotated counter-clockwise by the angle with this cosine and sine, as a tuple of two."""
    return cos * x - sin * y, sin * x + cos * y


@leaf
def turn(links, product, drives):
    """(cosine, sine, rate, second derivative) of the angle that rotates E of a product."""
    d = links.product_drive[product]
    if d < 0:
        return 1.0, 0.0, 0.0, 0.0
    return np.cos(drives[d, 0]), np.sin(drives[d, 0]), drives[d, 1], drives[d, 2]


@leaf
def factors(links, product, cos, sin, dz):
    """Both factors of a product of two vectors, R E and F, as x and y of each."""
    e, f = links.product_first[product], links.product_second[product]
    x, y = vector_change(links, e, dz)
    ex, ey = rotated(cos, sin, links.vector_rest[e, 0] + x, links.vector_rest[e, 1] + y)
    x, y = vector_change(links, f, dz)
    return ex, ey, links.vector_rest[f, 0] + x, links.vector_rest[f, 1] + y


@leaf
def push(links, vector, x, y, forces):
    """forces += `W_j^T (x, y)`: force (x, y) on a vector."""
    for k in range(links.vector_start[vector], links.vector_start[vector + 1]):
        p, c, n = links.vector_points[k], links.vector_weights[k, 0], links.vector_weights[k, 1]
        forces[p, 0] += c * x + n * y
        forces[p, 1] += c * y - n * x


@leaf
def slope(links, vector, row, x, y, slopes):
    """Add `W_j^T (x, y)` of a vector to the slopes of a row."""
    for k in range(links.vector_start[vector], links.vector_start[vector + 1]):
        p, c, n = links.vector_points[k], links.vector_weights[k, 0], links.vector_weights[k, 1]
        at = links.row_start[row]
        while links.row_columns[at] != 2 * p:
            at += 2
        slopes[at] += c * x + n * y
        slopes[at + 1] += c * y - n * x


@leaf
def along(links, slopes, row, places):
    """Row number `row` of phi_z times places (points, 2), a number; slopes has the entries of phi_z, row after row."""
    total = 0.0
    for e in range(links.row_start[row], links.row_start[row + 1]):
        i = links.row_columns[e]
        total += slopes[e] * places[i // 2, i % 2]
    return total


@part
def add_rows(links, slopes, lam, forces):
    """forces (points, 2) of the joints' points += phi_z^T lam.

    slopes has the entries of phi_z, row after row, and lam (m,) the multipliers.
    """
    for k in range(lam.shape[0]):
        for e in range(links.row_start[k], links.row_start[k + 1]):
            i = links.row_columns[e]
            forces[i >> 1, i & 1] += slopes[e] * lam[k]


@leaf
def cosine(ex, ey, fx, fy):
    """Cosine of the angle between F and E rotated by -90 degrees: of the angle error of a `cross` of two vectors."""
    return (ey * fx - ex * fy) / np.sqrt((ex * ex + ey * ey) * (fx * fx + fy * fy))


@shared
def joint_forces(links, drives, dz, lam, phi, forces):
    """Overwrite phi (m,) at displacements dz (points, 2); forces (points, 2) += phi_z^T lam.

    Returns the least cosine of the one-way products, 1 without any.
    """
    least = 1.0
    for k in range(phi.shape[0]):
        phi[k] = links.row_constant[k] + along(links, links.row_slopes, k, dz)
    add_rows(links, links.row_slopes, lam, forces)
    add_shifts(links, drives, 0, phi)
    for p in range(links.product_row.shape[0]):
        k = links.product_row[p]
        c, n, _, _ = turn(links, p, drives)
        ex, ey, fx, fy = factors(links, p, c, n, dz)
        phi[k] += ex * fx + ey * fy
        if links.product_one_way[p]:
            least = min(least, cosine(ex, ey, fx, fy))
        if not links.product_rate[p]:
            push(links, links.product_first[p], lam[k] * (c * fx + n * fy), lam[k] * (c * fy - n * fx), forces)
        push(links, links.product_second[p], lam[k] * ex, lam[k] * ey, forces)
    for i in range(links.velocity_rows.shape[0]):
        phi[links.velocity_rows[i]] = 0.0
    return least


@leaf
def pressure(slips, lam, k):
    """|lam_on| of row k that slips."""
    first, end = slips.on_start[k], slips.on_start[k + 1]
    if slips.on_contact[k]:
        return -lam[slips.on[first]]
    squares = 0.0
    for j in range(first, end):
        squares += lam[slips.on[j]] ** 2
    return np.sqrt(squares)


@part
def slip_forces(slips, drives, dz, lam, forces):
    """forces (points, 2) += the friction of rows that slip, at displacements dz (points, 2) and multipliers lam."""
    for k in range(slips.mu.shape[0]):
        friction = slips.constant[k] + slips.mu[k] * pressure(slips, lam, k)
        for e in range(slips.row_start[k], slips.row_start[k + 1]):
            i = slips.row_columns[e]
            forces[i >> 1, i & 1] += slips.row_slopes[e] * friction
    for p in range(slips.product_row.shape[0]):
        k = slips.product_row[p]
        friction = slips.constant[k] + slips.mu[k] * pressure(slips, lam, k)
        c, n, _, _ = turn(slips, p, drives)
        ex, ey, _, _ = factors(slips, p, c, n, dz)
        push(slips, slips.product_second[p], friction * ex, friction * ey, forces)


@part
def slip_slopes(slips, drives, dz, lam, rows, values):
    """values = the derivatives of `slip_forces` in the multipliers that press, one after the other; rows: scratch for the slopes of the rows."""
    joint_jacobian(slips, drives, dz, rows)
    at = 0
    for k in range(slips.mu.shape[0]):
        size = pressure(slips, lam, k)
        for j in range(slips.on_start[k], slips.on_start[k + 1]):
            share = -1.0 if slips.on_contact[k] else (lam[slips.on[j]] / size if size > 0.0 else 0.0)
            for e in range(slips.row_start[k], slips.row_start[k + 1]):
                values[at] = slips.mu[k] * share * rows[e]
                at += 1


@part
def add_shifts(links, values, order, rows):
    """Add a derivative of the profiles to that derivative (0: phi, 1: rate, 2: bias) of the rows that they shift. values (profiles, 3)."""
    for i in range(links.shift_row.shape[0]):
        column = order - 1 + links.shift_order[i]
        if column >= 0:
            rows[links.shift_row[i]] += links.shift_factor[i] * values[links.shift_drive[i], column]


@entry
def flipped(links, drives, dz):
    """The first row whose one-way product is on the wrong side, or -1."""
    for p in range(links.product_row.shape[0]):
        if links.product_one_way[p]:
            c, n, _, _ = turn(links, p, drives)
            ex, ey, fx, fy = factors(links, p, c, n, dz)
            if not cosine(ex, ey, fx, fy) > 0.0:
                return links.product_row[p]
    return -1


@shared
def joint_jacobian(links, drives, dz, slopes):
    """Fill slopes with phi_z, the slopes of the rows in the places and directions of the points."""
    put(1.0, links.row_slopes, slopes)
    for p in range(links.product_row.shape[0]):
        k = links.product_row[p]
        c, n, _, _ = turn(links, p, drives)
        ex, ey, fx, fy = factors(links, p, c, n, dz)
        if not links.product_rate[p]:
            slope(links, links.product_first[p], k, c * fx + n * fy, c * fy - n * fx, slopes)
        slope(links, links.product_second[p], k, ex, ey, slopes)


@entry
def joint_curvature(links, drives, lam, curvature):
    """Blocks of the coupling += d(phi_z^T lam)/dz: `lam W_i^T R^T W_j` between the points of E and those of F.

    A velocity row acts on the points of F alone, so that its part is not symmetric.
    """
    at = 0
    for p in range(links.product_row.shape[0]):
        e, f = links.product_first[p], links.product_second[p]
        if links.vector_start[e] == links.vector_start[e + 1] or links.vector_start[f] == links.vector_start[f + 1]:
            continue
        c, n, _, _ = turn(links, p, drives)
        for i in range(links.vector_start[e], links.vector_start[e + 1]):
            x, y = rotated(c, n, links.vector_weights[i, 0], links.vector_weights[i, 1])
            for j in range(links.vector_start[f], links.vector_start[f + 1]):
                x1, y1 = rotated(x, -y, links.vector_weights[j, 0], links.vector_weights[j, 1])
                x1, y1 = lam[links.product_row[p]] * x1, lam[links.product_row[p]] * y1
                block = links.coupling.products[at]
                if not links.product_rate[p]:
                    _couple(block, x1, -y1, curvature)
                _couple(links.coupling.mirror[block], x1, y1, curvature)
                at += 1


@leaf
def _couple(block, x, y, curvature):
    """Add ((x, y), (-y, x)) to a block."""
    curvature[block, 0, 0] += x
    curvature[block, 0, 1] += y
    curvature[block, 1, 0] -= y
    curvature[block, 1, 1] += x


@entry
def joint_rates(links, drives, dz, vz, phi_t, rate, bias):
    """Fill phi_t, rate = phi_z vz + phi_t and the bias `(phi_q v)_q v + 2 phi_qt v + phi_tt`, each (m,)."""
    for k in range(rate.shape[0]):
        phi_t[k] = bias[k] = 0.0
        rate[k] = along(links, links.row_slopes, k, vz)
    for i in range(links.velocity_rows.shape[0]):
        k = links.velocity_rows[i]
        phi_t[k] = links.row_constant[k]
        rate[k] += links.row_constant[k]
    add_shifts(links, drives, 1, phi_t)
    add_shifts(links, drives, 1, rate)
    add_shifts(links, drives, 2, bias)
    for p in range(links.product_row.shape[0]):
        k = links.product_row[p]
        c, n, speed, second = turn(links, p, drives)
        ex, ey, fx, fy = factors(links, p, c, n, dz)
        ux, uy = vector_change(links, links.product_first[p], vz)
        ux, uy = rotated(c, n, ux, uy)
        gx, gy = vector_change(links, links.product_second[p], vz)
        if links.product_rate[p]:
            rate[k] += ex * gx + ey * gy
            bias[k] += (ux - speed * ey) * gx + (uy + speed * ex) * gy
            continue
        across, within = ex * fy - ey * fx, ex * fx + ey * fy
        phi_t[k] += speed * across
        rate[k] += speed * across + ux * fx + uy * fy + ex * gx + ey * gy
        bias[k] += 2.0 * (ux * gx + uy * gy) + second * across - speed * speed * within
        bias[k] += 2.0 * speed * (ux * fy - uy * fx + ex * gy - ey * gx)


@part
def joint_rate_jacobian(links, drives, dz, vz, slopes):
    """Overwrite slopes with the entries of d(phi_z vz + phi_t)/dz, row after row as those of phi_z.

    dz, vz (points, 2): displacements and velocities of the points.
    """
    zero(slopes)
    for p in range(links.product_row.shape[0]):
        k, e, f = links.product_row[p], links.product_first[p], links.product_second[p]
        c, n, speed, _ = turn(links, p, drives)
        ex, ey, fx, fy = factors(links, p, c, n, dz)
        ux, uy = vector_change(links, e, vz)
        ux, uy = rotated(c, n, ux, uy)
        gx, gy = vector_change(links, f, vz)
        if links.product_rate[p]:
            slope(links, e, k, c * gx + n * gy, c * gy - n * gx, slopes)
            continue
        gx, gy = gx + speed * fy, gy - speed * fx
        slope(links, e, k, c * gx + n * gy, c * gy - n * gx, slopes)
        slope(links, f, k, ux - speed * ey, uy + speed * ex, slopes)


@entry
def rows_of_frames(links, drives, qs, vs, points, spare, phi, rates):
    """Fill phi and its rate (frames, m) in frames qs and vs (frames, pairs, 2). points (3, points, 2), spare (2, m): scratch."""
    dz, vz, forces = points[0], points[1], points[2]
    for f in range(qs.shape[0]):
        point_values(links, qs[f], dz)
        point_values(links, vs[f], vz)
        zero(spare[0])
        joint_forces(links, drives[f], dz, spare[0], phi[f], forces)
        joint_rates(links, drives[f], dz, vz, spare[0], rates[f], spare[1])


@entry
def joint_change(links, drives, gains, h, points, phi, rate):
    """Add the changes of phi and rate = phi_z vz + phi_t in a step of h. Their round-off is that of second differences.

    points (4, points, 2): dz and vz at the start of the step, dd and dv: the points move by `h vz + dd`, their velocities by dv. drives: at the start of the step; gains (profiles, 3): increments of the profile, of
    the profile minus h times its rate, of its rate. In `phi += h rate + ...`, rate replaces terms that cancel. With e = R E, `e_0 . f_0`
    becomes `e_0 . f_0 + h rate + dd_e . f_0 + e_0 . dd_f + de . df`. phi of velocity rows stays zero.
    """
    dz, vz, dd, dv = points[0], points[1], points[2], points[3]
    for k in range(phi.shape[0]):
        phi[k] += h * rate[k] + along(links, links.row_slopes, k, dd)
        rate[k] += along(links, links.row_slopes, k, dv)
    for i in range(links.shift_row.shape[0]):
        k, gain = links.shift_row[i], gains[links.shift_drive[i]]
        phi[k] += links.shift_factor[i] * gain[1]
        rate[k] += links.shift_factor[i] * gain[2 * links.shift_order[i]]
    for p in range(links.product_row.shape[0]):
        k, f = links.product_row[p], links.product_second[p]
        c, n, speed, _ = turn(links, p, drives)
        ex, ey, fx, fy = factors(links, p, c, n, dz)
        gx, gy = vector_change(links, f, vz)
        ddfx, ddfy = vector_change(links, f, dd)
        dvfx, dvfy = vector_change(links, f, dv)
        ux, uy, ddx, ddy, dvx, dvy = turning_change(links, p, c, n, speed, gains, h, points)
        dex, dey, dfx, dfy = h * ux + ddx, h * uy + ddy, h * gx + ddfx, h * gy + ddfy
        if links.product_rate[p]:
            rate[k] += ex * dvfx + ey * dvfy + dex * (gx + dvfx) + dey * (gy + dvfy)
            continue
        phi[k] += ddx * fx + ddy * fy + ex * ddfx + ey * ddfy + dex * dfx + dey * dfy
        rate[k] += dvx * (fx + dfx) + dvy * (fy + dfy) + ux * dfx + uy * dfy
        rate[k] += ex * dvfx + ey * dvfy + dex * (gx + dvfx) + dey * (gy + dvfy)
    for i in range(links.velocity_rows.shape[0]):
        phi[links.velocity_rows[i]] = 0.0


@part
def turning_change(links, product, cos, sin, speed, gains, h, points):
    """Velocity of e = R E of a product, its move minus h times the velocity, and its change of velocity.

    i rotates by a right angle, g is the increment of the angle, k = g - h theta', E_1 = E + h E' + dd_E:
    `e' = R (E' + theta' i E)`, `dd_e = R (dd_E + (cos g - 1) E_1 + (sin g - g) i E_1 + g i (E_1 - E) + k i E)`,
    `de' = R ((R(g) - I)(E_1' + theta_1' i E_1) + dE' + theta_1' i (E_1 - E) + (theta_1' - theta') i E)`.
    """
    e, dz, vz, dd, dv = links.product_first[product], points[0], points[1], points[2], points[3]
    ux, uy = vector_change(links, e, vz)
    ddx, ddy = vector_change(links, e, dd)
    dvx, dvy = vector_change(links, e, dv)
    d = links.product_drive[product]
    if d < 0:
        return ux, uy, ddx, ddy, dvx, dvy
    x, y = vector_change(links, e, dz)
    x, y = links.vector_rest[e, 0] + x, links.vector_rest[e, 1] + y
    g, ahead, faster = gains[d, 0], gains[d, 1], gains[d, 2]
    mx, my = h * ux + ddx, h * uy + ddy
    x1, y1 = x + mx, y + my
    less, sine, cubic = -2.0 * np.sin(0.5 * g) ** 2, np.sin(g), sine_less_angle(g)
    px, py = ddx + less * x1 - cubic * y1 - g * my - ahead * y, ddy + less * y1 + cubic * x1 + g * mx + ahead * x
    later = speed + faster
    wx, wy = ux + dvx - later * y1, uy + dvy + later * x1
    qx = less * wx - sine * wy + dvx - later * my - faster * y
    qy = less * wy + sine * wx + dvy + later * mx + faster * x
    ux, uy = rotated(cos, sin, ux - speed * y, uy + speed * x)
    px, py = rotated(cos, sin, px, py)
    qx, qy = rotated(cos, sin, qx, qy)
    return ux, uy, px, py, qx, qy


@part
def sine_less_angle(angle):
    """sin(angle) - angle without cancellation."""
    if abs(angle) < 0.05:
        return -angle * angle * angle / 6.0 * (1.0 - angle * angle / 20.0 * (1.0 - angle * angle / 42.0))
    return np.sin(angle) - angle
