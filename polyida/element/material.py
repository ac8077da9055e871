"""St. Venant-Kirchhoff at a point, of one or two fields: plain formulas, traced into the kernels, valid for numpy arrays too.

With H = sum_i u_i (x) G_i and F = I + H (plane stress, c = E_mod / (1 - nu^2)):

    E = (H + H^T + H^T H) / 2,  S = lam_bar tr(E) I + two_mu E,  lam_bar = c nu,  two_mu = c (1 - nu)

Plane strain is the same with E_mod / (1 - nu^2) and nu / (1 - nu) in place of E_mod and nu. Matrices are tuples by rows, symmetric ones
(11, 12, 22). Strains are computed from H, not from F^T F - I, which would lose the digits of small strains.

Of two fields, a state F and a direction d = sum_i d_i (x) G_i:

    S = D : (E(F) + rate sym(F^T d) + square d^T d / 2),  P = F S

- Kelvin-Voigt: F the deformation, d its rate, rate = tau_v, square = 0, so that S = D : (E + tau_v Edot).
- Midpoint: F = (F_0 + F_1) / 2, d = (F_1 - F_0) / 2, square = 1, rate = 2 tau_v / h, so that
  S = D : ((E_0 + E_1) / 2 + tau_v (E_1 - E_0) / h), since E_0 + E_1 = 2 E(F) + d^T d, E_1 - E_0 = 2 sym(F^T d).
"""

from itertools import product

from polyida.jit.intrinsics import pair, traced


@traced(2)
def difference(a, b):
    """a - b of two plane vectors."""
    return a[0] - b[0], a[1] - b[1]


@traced(4)
def add_outer(h, d, g):
    """H + d (x) G."""
    return h[0] + d[0] * g[0], h[1] + d[0] * g[1], h[2] + d[1] * g[0], h[3] + d[1] * g[1]


@traced(2)
def add_times(f, p, g):
    """The vector f + p g of a 2 x 2 matrix p, by rows, and a vector g."""
    return f[0] + p[0] * g[0] + p[1] * g[1], f[1] + p[2] * g[0] + p[3] * g[1]


@traced(1)
def determinant(h):
    """det F of F = I + H; h: H by rows."""
    return (1.0 + h[0]) * (1.0 + h[3]) - h[1] * h[2]


def strain(h):
    """The Green-Lagrange strain E = (xx, xy, yy) of a displacement gradient H."""
    e11 = h[0] + 0.5 * (h[0] * h[0] + h[2] * h[2])
    e12 = 0.5 * ((h[1] + h[2]) + (h[0] * h[1] + h[2] * h[3]))
    return e11, e12, h[3] + 0.5 * (h[1] * h[1] + h[3] * h[3])


def second_piola(e, lam_bar, two_mu):
    """The second Piola-Kirchhoff stress S = lam_bar tr(E) I + two_mu E of a strain E."""
    e11, e12, e22 = e
    mean = lam_bar * (e11 + e22)
    return mean + two_mu * e11, two_mu * e12, mean + two_mu * e22


@traced(4)
def first_piola(h, weight, lam_bar, two_mu):
    """weight times the first Piola-Kirchhoff stress P = F S."""
    return carried(h, second_piola(strain(h), lam_bar * weight, two_mu * weight))


@traced(4)
def relaxing_piola(h, viscous_strain, kappa, weight, lam_bar, two_mu):
    """weight F S (xx, xy, yx, yy) with `S = D : (kappa E - viscous_strain)`, E the Green-Lagrange strain of h.

    viscous_strain (xx, xy, yy), as E; `D : e = lam_bar tr(e) I + two_mu e`.
    """
    return carried(h, second_piola(tuple(kappa * e - p for e, p in zip(strain(h), viscous_strain)), lam_bar * weight, two_mu * weight))


def carried(h, s):
    """The first Piola-Kirchhoff stress F S, (xx, xy, yx, yy), F = I + H."""
    s11, s12, s22 = s
    f11, f22 = 1.0 + h[0], 1.0 + h[3]
    return f11 * s11 + h[1] * s12, f11 * s12 + h[1] * s22, h[2] * s11 + f22 * s12, h[2] * s12 + f22 * s22


@traced(2)
def watch(state, h):
    """(least det F so far, sum of det F): nan and inf survive in the sum."""
    det = determinant(h)
    return state[0].least(det), state[1] + det


@traced(2)
def add_rotation(turn, weight, h):
    """turn + weight (F11 + F22, F21 - F12)."""
    return turn[0] + weight * (2.0 + h[0] + h[3]), turn[1] + weight * (h[2] - h[1])


@traced(2)
def add_energy(state, h, weight, lam_bar, two_mu):
    """(sum, lost digits) of weight S : E / 2 with compensated summation."""
    s11, s12, s22 = second_piola(strain(h), lam_bar, two_mu)
    e11, e12, e22 = strain(h)
    term = 0.5 * weight * (s11 * e11 + s22 * e22 + 2.0 * s12 * e12) - state[1]
    total = state[0] + term
    return total, (total - state[0]) - term


@traced(3)
def add_strain(state, h, weight):
    """state + weight (E11, E22, 2 E12)."""
    e11, e12, e22 = strain(h)
    return state[0] + weight * e11, state[1] + weight * e22, state[2] + weight * (e12 + e12)


@traced(3)
def add_cauchy(state, h, weight, lam_bar, two_mu):
    """state + weight (sigma_xx, sigma_yy, sigma_xy) with sigma = F S F^T / det F."""
    return add_cauchy_of(state, h, first_piola(h, weight / determinant(h), lam_bar, two_mu))


def add_cauchy_of(state, h, p):
    """state + (xx, yy, xy) of P F^T."""
    p11, p12, p21, p22 = p
    f11, f22 = 1.0 + h[0], 1.0 + h[3]
    xx, yy, xy = p11 * f11 + p12 * h[1], p21 * h[2] + p22 * f22, p11 * h[2] + p12 * f22
    return state[0] + xx, state[1] + yy, state[2] + xy


@traced(10)
def moduli(h, weight, lam_bar, two_mu):
    """weight A = weight dP/dF, symmetric in (a k), (b l); order 1111 1112 1121 1122 1212 1221 1222 2121 2122 2222.

    A[a, k, b, l] = delta_ab S_kl + lam_bar F_ak F_bl + two_mu / 2 ((F F^T)_ab delta_kl + F_al F_bk)
    """
    return moduli_of_stress(h, second_piola(strain(h), lam_bar * weight, two_mu * weight), lam_bar * weight, two_mu * weight)


@traced(10)
def relaxed_moduli(h, viscous_strain, weight, lam_bar, two_mu, change):
    """The ten numbers of `moduli`, times weight, with the stress S = -D : viscous_strain and `change` times lam_bar and two_mu.

    Of the stress itself lam_bar and two_mu are not changed. viscous_strain: (xx, xy, yy).
    """
    lam_bar, two_mu = lam_bar * weight, two_mu * weight
    return moduli_of_stress(h, second_piola(viscous_strain, -1.0 * lam_bar, -1.0 * two_mu), change * lam_bar, change * two_mu)


def moduli_of_stress(h, s, lam_bar, two_mu):
    """A of `moduli` from the stress S; S, lam_bar and two_mu include the weight."""
    half, (s11, s12, s22) = 0.5 * two_mu, s
    f11, f12, f21, f22 = 1.0 + h[0], h[1], h[2], 1.0 + h[3]
    both = lam_bar + half
    c11, c12, c22 = half * (f11 * f11 + f12 * f12), half * (f11 * f21 + f12 * f22), half * (f21 * f21 + f22 * f22)
    straight, crossed = f11 * f22, f12 * f21
    return (
        s11 + c11 + both * f11 * f11,
        s12 + both * f11 * f12,
        c12 + both * f11 * f21,
        lam_bar * straight + half * crossed,
        s22 + c11 + both * f12 * f12,
        lam_bar * crossed + half * straight,
        c12 + both * f12 * f22,
        s11 + c22 + both * f21 * f21,
        s12 + both * f21 * f22,
        s22 + c22 + both * f22 * f22,
    )


@traced(8)
def moduli_times(a, g):
    """T[a, k, b] = sum_l A[a, k, b, l] G[l], order 111 121 112 122 211 221 212 222."""
    a1111, a1112, a1121, a1122, a1212, a1221, a1222, a2121, a2122, a2222 = a
    return (
        a1111 * g[0] + a1112 * g[1],
        a1112 * g[0] + a1212 * g[1],
        a1121 * g[0] + a1122 * g[1],
        a1221 * g[0] + a1222 * g[1],
        a1121 * g[0] + a1221 * g[1],
        a1122 * g[0] + a1222 * g[1],
        a2121 * g[0] + a2122 * g[1],
        a2122 * g[0] + a2222 * g[1],
    )


@traced(4)
def add_stiffness(k, g, t):
    """The 2 x 2 matrix K[a, b] + sum_k G[k] T[a, k, b], by rows: K by rows, a vector G, T in the order of `moduli_times`."""
    return (
        k[0] + g[0] * t[0] + g[1] * t[1],
        k[1] + g[0] * t[2] + g[1] * t[3],
        k[2] + g[0] * t[4] + g[1] * t[5],
        k[3] + g[0] * t[6] + g[1] * t[7],
    )


@traced(4)
def transposed(k):
    """Transpose of a 2 x 2 matrix k, a tuple by rows."""
    return k[0], k[2], k[1], k[3]


@traced(4)
def symmetric(k):
    """The matrix with its upper entry mirrored: exact symmetry."""
    return k[0], k[1], k[1], k[3]


@traced(4)
def add(a, b):
    """a + b of two matrices."""
    return tuple(x + y for x, y in zip(a, b))


@traced(4)
def negative(k):
    """The negative of a 2 x 2 matrix K."""
    return tuple(0.0 - x for x in k)


@traced(1, pair)
def add_product(total, factor, value):
    """The sum total + factor times value."""
    return total + factor * value


@traced(1, pair)
def scaled(factor, value):
    """The product of factor and value."""
    return factor * value


@traced(2)
def combination(a, b, p, q):
    """p a + q b of two plane vectors."""
    return p * a[0] + q * b[0], p * a[1] + q * b[1]


@traced(4)
def advanced(h, d, ahead):
    """The matrix H + ahead D."""
    return tuple(x + ahead * y for x, y in zip(h, d))


def two_state_strain(h, d, rate, square):
    """The strain E(F) + rate sym(F^T d) + square d^T d / 2, (xx, xy, yy), F = I + H; h and d by rows."""
    e11, e12, e22 = strain(h)
    f11, f12, f21, f22 = 1.0 + h[0], h[1], h[2], 1.0 + h[3]
    half, shear = 0.5 * square, 0.5 * rate
    return (
        e11 + rate * (f11 * d[0] + f21 * d[2]) + half * (d[0] * d[0] + d[2] * d[2]),
        e12 + shear * (f11 * d[1] + f21 * d[3] + f12 * d[0] + f22 * d[2]) + half * (d[0] * d[1] + d[2] * d[3]),
        e22 + rate * (f12 * d[1] + f22 * d[3]) + half * (d[1] * d[1] + d[3] * d[3]),
    )


@traced(4)
def two_state_piola(h, d, weight, lam_bar, two_mu, rate, square):
    """weight F S (xx, xy, yx, yy) with `S = D : (E(F) + rate sym(F^T d) + square d^T d / 2)` of the state H = h and the direction d.

    h, d: by rows, F = I + H; `D : e = lam_bar tr(e) I + two_mu e`.
    """
    return carried(h, second_piola(two_state_strain(h, d, rate, square), lam_bar * weight, two_mu * weight))


@traced(16)
def two_state_moduli(h, d, weight, lam_bar, two_mu, rate, factors):
    """weight A for factors (c_s, c_f, c_d) and square = 0, order [a][b][k][l] (here m for l), W = c_f F + c_d d:

    A[a, k, b, l] = c_s delta_ab S_kl + lam_bar F_ak W_bl + two_mu / 2 ((F W^T)_ab delta_kl + F_al W_bk)
    """
    c_s, c_f, c_d = factors
    lam_bar, two_mu = lam_bar * weight, two_mu * weight
    half = 0.5 * two_mu
    s11, s12, s22 = second_piola(two_state_strain(h, d, rate, 0.0), c_s * lam_bar, c_s * two_mu)
    s = ((s11, s12), (s12, s22))
    f = ((1.0 + h[0], h[1]), (h[2], 1.0 + h[3]))
    other = [[c_f * f[b][m] + c_d * d[2 * b + m] for m in (0, 1)] for b in (0, 1)]
    entries = []
    for a, b, k, m in product((0, 1), repeat=4):
        entry = lam_bar * f[a][k] * other[b][m] + half * f[a][m] * other[b][k]
        if k == m:
            entry = entry + half * (f[a][0] * other[b][0] + f[a][1] * other[b][1])
        entries.append(entry + s[k][m] if a == b else entry)
    return tuple(entries)


@traced(8)
def all_moduli_times(a, g):
    """T[a, k, b] = sum_l A[a, k, b, l] G[l] of two_state_moduli, order 111 121 112 122 211 221 212 222."""
    return tuple(a[k] * g[0] + a[k + 1] * g[1] for k in range(0, 16, 2))
