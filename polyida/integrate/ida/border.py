"""The border of IDA's iteration matrix on a scene: constraints, their rates and the masses at points, on the points z = A q.

With B = Bz A and H = d(B v + phi_t)/dq = Hz A, S and M those of the plates, m the masses at points, C the curvature of the motors,

    S dq + A^T (w + Bz^T dlam + cj m A A^T Bz^T dmu) + cj M B^T dmu = r2 + cj M r1,   w = (C + cj^2 m) A dq
    Bz A dq = r3,   (Hz + cj Bz) A dq + Bz A A^T Bz^T dmu = r4 + Bz A r1,   dv = cj dq + A^T Bz^T dmu - r1
"""

from polyida.assembly import corotated
from polyida.assembly.rows import joints
from polyida.compiled import leaf, part
from polyida.linear.dense import clear, solve_small


@part
def stabilised_border(s, c, cm, cr, w, drives, cj, r, n, m):
    """Solve for w, dlam, dmu; move w.dq by them; leave A's forces Bz^T dmu in w.swing."""
    wide = w.cross.shape[0]
    corotated.points_matrix(s.links, c, cr)
    for i in range(wide):
        for j in range(wide):
            w.cross[i, j] = cr.g[i, j]
    corotated.points_matrix(s.links, cm, cr)
    g, h = w.cross, cr.g
    joints.joint_jacobian(s.links, drives, w.dz, cr.slopes)
    joints.joint_rate_jacobian(s.links, drives, w.dz, w.vz, w.rate_slopes)
    corotated.fill_curvature(s.links, cr, drives, w.lam, cj * cj)
    for i in range(wide):
        for j in range(wide):
            h[i, j] *= cj
        for f in range(w.own.shape[0]):
            if s.links.point_mass[f] != 0.0:
                for k in range(2):
                    for e in range(w.own.shape[0]):
                        h[i, 2 * e + k] += cj * g[i, 2 * f + k] * s.links.point_mass[f] * w.own[f, e]
    times_jacobian(s.links, cr, g, cr.gb)
    times_jacobian(s.links, cr, h, w.hb)
    fill_stabilised(s.links, c, cr, w, cj, r, n, m)
    if not solve_small(w.small, w.unknown, w.last):
        return False
    apply_border(s.links, c, cm, cr, w, cj, m)
    return True


@part
def times_jacobian(s, cr, matrix, product):
    """product (2 points, m) = matrix Bz^T."""
    for k in range(product.shape[1]):
        for p in range(product.shape[0]):
            total = 0.0
            for e in range(s.row_start[k], s.row_start[k + 1]):
                total += matrix[p, s.row_columns[e]] * cr.slopes[e]
            product[p, k] = total


@part
def fill_stabilised(s, c, cr, w, cj, r, n, m):
    """The border's system: curvature, position and velocity rows, each a combination of components of A dq."""
    count = c.active.shape[0]
    joints.point_values(s, w.dq, w.moved)
    clear(w.small)
    for i in range(w.unknown.shape[0]):
        w.unknown[i] = 0.0
    for i in range(count):
        w.small[w.place[i], w.place[i]] = 1.0
        for j in c.active:
            if cr.curvature[c.active[i], j] != 0.0:
                add_row(c, cr, w, w.place[i], cr.curvature[c.active[i], j], j, m)
    for k in range(m):
        for e in range(s.row_start[k], s.row_start[k + 1]):
            j = s.row_columns[e]
            add_row(c, cr, w, w.place[count + k], cr.slopes[e], j, m)
            add_row(c, cr, w, w.place[count + m + k], w.rate_slopes[e] + cj * cr.slopes[e], j, m)
    close_stabilised(s, c, cr, w, r, n, m, count)


@leaf
def add_row(c, cr, w, at, value, j, m):
    """Add value times component j of `A dq = A y - g (w + Bz^T dlam) - h Bz^T dmu` to equation `at`."""
    count = c.active.shape[0]
    if value == 0.0:
        return
    w.unknown[at] += value * w.moved[j // 2, j % 2]
    for o in range(count):
        w.small[at, w.place[o]] += value * w.cross[j, c.active[o]]
    for k in range(m):
        w.small[at, w.place[count + k]] += value * cr.gb[j, k]
        w.small[at, w.place[count + m + k]] += value * w.hb[j, k]


@part
def close_stabilised(s, c, cr, w, r, n, m, count):
    """Right-hand sides r3, r4 + Bz A r1 and the block -Bz A A^T Bz^T of the velocity constraint."""
    for i in range(w.right.shape[0]):
        w.right[i, 0], w.right[i, 1] = r[2 * i], r[2 * i + 1]
    joints.point_values(s, w.right, w.moved)
    for k in range(m):
        at = w.place[count + m + k]
        w.unknown[w.place[count + k]] -= r[2 * n + k]
        w.unknown[at] -= r[2 * n + m + k]
        for e in range(s.row_start[k], s.row_start[k + 1]):
            p, value = s.row_columns[e], cr.slopes[e]
            w.unknown[at] -= value * w.moved[p // 2, p % 2]
            for o in range(m):
                for i in range(s.row_start[o], s.row_start[o + 1]):
                    q = s.row_columns[i]
                    if q % 2 == p % 2:
                        w.small[at, w.place[count + m + o]] -= value * w.own[p // 2, q // 2] * cr.slopes[i]


@part
def apply_border(s, c, cm, cr, w, cj, m):
    """dq -= X (w + Bz^T dlam + cj m A A^T Bz^T dmu) + cj S^-1 M A^T Bz^T dmu; w.swing = Bz^T dmu."""
    clear(w.swing)
    for i in range(cr.pull.shape[0]):
        cr.pull[i] = 0.0
    count = c.active.shape[0]
    for i in range(count):
        cr.pull[c.active[i]] = w.unknown[w.place[i]]
    for k in range(m):
        for e in range(s.row_start[k], s.row_start[k + 1]):
            p = s.row_columns[e]
            cr.pull[p] += cr.slopes[e] * w.unknown[w.place[count + k]]
            w.swing[p // 2, p % 2] += cr.slopes[e] * w.unknown[w.place[count + m + k]]
    for f in range(w.own.shape[0]):
        if s.point_mass[f] != 0.0:
            for e in range(w.own.shape[0]):
                cr.pull[2 * f] += cj * s.point_mass[f] * w.own[f, e] * w.swing[e, 0]
                cr.pull[2 * f + 1] += cj * s.point_mass[f] * w.own[f, e] * w.swing[e, 1]
    corotated.pull_points(s, c, cr, w.dq)
    for p in range(cr.pull.shape[0]):
        cr.pull[p] = cj * w.swing[p // 2, p % 2]
    corotated.pull_points(s, cm, cr, w.dq)
