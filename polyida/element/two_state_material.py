"""St. Venant-Kirchhoff at a point that sees two fields: a state F and a direction d = sum_i d_i (x) G_i.

    S = D : (E(F) + rate sym(F^T d) + square d^T d / 2),  P = F S

- Kelvin-Voigt: F the deformation, d its rate, rate = tau_v, square = 0, so that S = D : (E + tau_v Edot).
- Midpoint: F = (F_0 + F_1) / 2, d = (F_1 - F_0) / 2, square = 1, rate = 2 tau_v / h, so that
  S = D : ((E_0 + E_1) / 2 + tau_v (E_1 - E_0) / h), since E_0 + E_1 = 2 E(F) + d^T d, E_1 - E_0 = 2 sym(F^T d).

Both derivatives have the form A[a, k, b, l] = c_s delta_ab S_kl + F_am D_mkln W_bn with W = c_f F + c_d d: unsymmetric
in (a k), (b l) unless W is parallel to F. Matrices are tuples by rows, symmetric ones (11, 12, 22).
"""

from itertools import product

from polyida.element.material import carried, second_piola, strain
from polyida.jit.intrinsics import traced


@traced(2)
def combination(a, b, p, q):
    """p a + q b of two plane vectors."""
    return p * a[0] + q * b[0], p * a[1] + q * b[1]


@traced(4)
def advanced(h, d, ahead):
    """H + ahead d."""
    return tuple(x + ahead * y for x, y in zip(h, d))


def two_state_strain(h, d, rate, square):
    """E(F) + rate sym(F^T d) + square d^T d / 2."""
    e11, e12, e22 = strain(h)
    f11, f12, f21, f22 = 1.0 + h[0], h[1], h[2], 1.0 + h[3]
    half, shear = 0.5 * square, 0.5 * rate
    return (
        e11 + rate * (f11 * d[0] + f21 * d[2]) + half * (d[0] * d[0] + d[2] * d[2]),
        e12 + shear * (f11 * d[1] + f21 * d[3] + f12 * d[0] + f22 * d[2]) + half * (d[0] * d[1] + d[2] * d[3]),
        e22 + rate * (f12 * d[1] + f22 * d[3]) + half * (d[1] * d[1] + d[3] * d[3]),
    )


@traced(4)
def two_state_piola(h, d, w, spherical, deviatoric, rate, square):
    """w P = w F S."""
    return carried(h, second_piola(two_state_strain(h, d, rate, square), spherical * w, deviatoric * w))


@traced(16)
def two_state_moduli(h, d, w, spherical, deviatoric, rate, square, factors):
    """w A for factors (c_s, c_f, c_d), order [a][b][k][l] (here m for l):

    A[a, k, b, l] = c_s delta_ab S_kl + spherical F_ak W_bl + deviatoric / 2 ((F W^T)_ab delta_kl + F_al W_bk)
    """
    c_s, c_f, c_d = factors
    ball, half = spherical * w, 0.5 * (deviatoric * w)
    s11, s12, s22 = second_piola(two_state_strain(h, d, rate, square), c_s * ball, c_s * (deviatoric * w))
    s = ((s11, s12), (s12, s22))
    f = ((1.0 + h[0], h[1]), (h[2], 1.0 + h[3]))
    other = [[c_f * f[b][m] + c_d * d[2 * b + m] for m in (0, 1)] for b in (0, 1)]
    return tuple(_modulus(index, s, f, other, ball, half) for index in product((0, 1), repeat=4))


def _modulus(index, s, f, other, ball, half):
    """One entry of A."""
    a, b, k, m = index
    entry = ball * f[a][k] * other[b][m] + half * f[a][m] * other[b][k]
    if k == m:
        entry = entry + half * (f[a][0] * other[b][0] + f[a][1] * other[b][1])
    return entry + s[k][m] if a == b else entry


@traced(8)
def all_moduli_times(a, g):
    """T[a, k, b] = sum_l A[a, k, b, l] G[l] of two_state_moduli, order 111 121 112 122 211 221 212 222."""
    return tuple(a[k] * g[0] + a[k + 1] * g[1] for k in range(0, 16, 2))
