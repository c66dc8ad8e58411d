"""Linear stability of homogeneous flow in closed form (sections 3, 5, appendix A): numpy only.

Wave vectors are dimensionless, A d k (NGF, LI) or sqrt(nu_I) d k (IG), and growth
rates those of the paper, A^2 d^2 phi rho_s lambda/eta0 (NGF, LI) or nu_I d^2 phi
rho_s lambda/eta0 (IG), unless a name says otherwise. Arrays of wave vectors have
shape (..., n) with n = 2 or 3; inertial numbers broadcast against (...).

Why closed forms suffice: an incompressible perturbation has v.k = 0, and there the
tensor (3.16) is symmetric of rank one but for -|k|^2, so that the largest growth is

    |k|^2 (2 r |P N k^|^2 / (1 - sqrt(2) q k^.N k^) - 1),     P = 1 - k^ k^.

For a given k^.N k^ the numerator is largest in the plane of the extreme principal
directions of N, so every extremum over directions is one of a quadratic in
m = k^.N k^, in two dimensions as in three; and r and q of NGF are linear in
x = 1/(1 + nu xi^2 |k|^2), so the cut-off is a root of a quadratic in x.
"""

from dataclasses import dataclass

import numpy as np

from ..material import laws

ROOT_2 = np.sqrt(2.0)
#: Velocity gradients over gdot0, by name: (3.20) and (A 8).
BASE_FLOWS = {"pure_shear": np.array([[0.5, 0.0], [0.0, -0.5]]),
              "simple_shear": np.array([[0.0, 1.0], [0.0, 0.0]])}
#: Inertial numbers among which critical ones are sought.
I_RANGE = 1e-6, 1e2
#: The models whose growth rates are known.
MODELS = "ngf", "ngf_primitive", "li", "ig"
#: Rounds in which `_relaxing_ridge` settles; each about doubles the digits.
ROUNDS = 8


@dataclass(frozen=True)
class Coefficients:
    """mu_loc(I0), nu of (3.6) and nu xi^2/(A d)^2 at base-state inertial numbers.

    Attributes
    ----------
    model : str
        One of `MODELS`.
    mu, nu, spread : ndarray
        One shape, that of the inertial numbers. ``spread`` is not a number unless the model is
        NGF in one of its forms. It stays finite at I0 = 0 (appendix B).
    relaxation : ndarray or float
        T, the time t0 of the primitive form in the units of growth rates: t0 times `viscous_rate`.
        0 for other models.
    """

    model: str
    mu: np.ndarray
    nu: np.ndarray
    spread: np.ndarray
    relaxation: object = 0.0

    @classmethod
    def of(cls, law, model, I0, relaxation=None):
        """Return the coefficients of a `pgran.material.laws.Law` at inertial numbers.

        Parameters
        ----------
        law : pgran.material.laws.Law
        model : str
            One of `MODELS`.
        I0 : ndarray or float
            Inertial numbers >= 0.
        relaxation : ndarray or float, optional
            T > 0, as among the attributes; for the primitive form, and only for it.

        Raises
        ------
        ValueError
            If the model is another one, lacks a cooperativity length, or I0 or T is out of bounds.
        """
        if model not in MODELS:
            raise ValueError(f"linear theory of the model {model}: it is known for "
                             f"{', '.join(MODELS)}")
        I0 = np.asarray(I0, dtype=float)
        if not np.all(I0 >= 0.0):
            raise ValueError(f"inertial number {I0}: allowed is a number >= 0")
        if (model == "ngf_primitive") != (relaxation is not None):
            raise ValueError(f"relaxation time: the model {model} "
                             f"{'needs one' if relaxation is None else 'has none'}")
        if relaxation is not None and not np.all(np.asarray(relaxation) > 0.0):
            raise ValueError(f"relaxation time {relaxation}: allowed is a number > 0")
        mu, nu = laws.sensitivity(law, I0)
        return cls(model, mu, nu, cls._spread(law, mu, nu) if model in ("ngf", "ngf_primitive")
                   else np.full_like(mu, np.nan), 0.0 if relaxation is None else relaxation)

    @classmethod
    def of_run(cls, parameters):
        """Return the coefficients of the reference flow of `pgran.options.Parameters`.

        Raises ValueError as `of` does, and where the model has no linear theory.
        """
        p, model = parameters, parameters.part("model")
        if model.theory is None:
            raise ValueError(f"the model {p.model} has no linear theory")
        law, relaxation = p.part("law").of(p), None
        if model.theory == "ngf_primitive":
            mu, _ = law.stress_ratio(np.asarray(p.inertial_number))
            relaxation = p.relaxation_time * viscous_rate(mu, p.A, p.phi, p.inertial_number)
        return cls.of(law, model.theory, p.inertial_number, relaxation)

    @staticmethod
    def _spread(law, mu, nu):
        """Nu xi^2/(A d)^2 with the law's own xi; at yield both factors vanish, not their ratio."""
        if law.inverse_length_squared is None:
            raise ValueError(f"the law {type(law).__name__} has no cooperativity length, so that "
                             "NGF is not defined with it; allowed is the model li")
        near = mu - law.yield_ratio < 1e-8 * mu
        _, slope = law.inverse_length_squared(np.nextafter(law.yield_ratio + 0.0 * mu, np.inf))
        inverse, _ = law.inverse_length_squared(np.where(near, np.nan, mu))
        return np.where(near, 1.0 / (mu * slope), nu / inverse)

    def share(self, square):
        """Return x = 1/(1 + nu xi^2 |k|^2), by which non-locality weighs nu; 1 for LI."""
        if self.model in ("li", "ig"):
            return np.ones_like(square)
        return 1.0 / (1.0 + self.spread * square)

    def r_q(self, square):
        """Return r0 and q0 of (3.13), (5.3) or their local limit, at ``square`` = |k|^2.

        For the primitive form ``square`` is |k|^2 + T lambda, with the growth rate lambda.
        """
        if self.model == "ig":
            return 1.0 - self.nu - square, self.mu * (1.0 - self.nu / 2.0 - square / 2.0)
        x = self.share(square)
        return (1.0 - self.nu) * x, self.mu * (1.0 - self.nu * x / 2.0)


def viscous_rate(mu, A, phi, I0):
    """Return eta0/(A^2 d^2 phi rho_s gdot0) = mu_loc/(A^2 phi I0^2).

    The paper's growth rates times this are in units of gdot0; its inverse is the weight of
    convection in (A 7).
    """
    return mu / (A**2 * phi * np.square(I0))


def flow_direction(gradient):
    """Return N (n, n), symmetric, deviatoric and of unit norm, of a velocity gradient L0 (n, n).

    Raises `ValueError` where L0 is not square, not finite, has divergence or is at rest.
    """
    gradient = np.asarray(gradient, dtype=float)
    if gradient.shape not in ((2, 2), (3, 3)) or not np.isfinite(gradient).all():
        raise ValueError(f"base flow {gradient.tolist()}: allowed is a 2 x 2 or 3 x 3 matrix")
    size = np.abs(gradient).max()
    if abs(np.trace(gradient)) > 1e-12 * size:
        raise ValueError(f"base flow {gradient.tolist()}: its divergence is "
                          f"{np.trace(gradient):.3g}; allowed is 0")
    D = (gradient + gradient.T) / 2.0
    norm = np.sqrt((D * D).sum())
    if not norm > 1e-12 * size:
        raise ValueError(f"base flow {gradient.tolist()}: it does not deform")
    return D / norm


def limit_of_stress_ratio(N):
    """Return the bound of (3.19) on mu_loc(I0): 1/(sqrt(2) n_max), 1 for plane flow."""
    return 1.0 / (ROOT_2 * np.linalg.eigvalsh(N)[-1])


def tensor(k, N, r, q, convection=0.0, gradient=None):
    """Return A_ik of (3.16) and the denominator |k|^2 - sqrt(2) q k.N k over |k|^2.

    ``k`` (..., n), ``r`` and ``q`` (...); with ``convection`` = A^2 phi I0^2/mu_loc and
    ``gradient`` = L0/gdot0 (n, n), (A 7). Shapes (..., n, n) and (...). Where the
    denominator vanishes the tensor is not a number. Raises `ValueError` for k = 0.
    """
    k = np.asarray(k, dtype=float)
    square = (k * k).sum(axis=-1)
    if not np.all(square > 0.0):
        raise ValueError("wave vector: allowed is any but the zero vector")
    r, q = np.broadcast_arrays(r, q)
    Nk = k @ N
    kNk = (k * Nk).sum(axis=-1)
    denominator = square - ROOT_2 * q * kNk
    singular = np.abs(denominator) <= 1e-12 * (square + np.abs(q * kNk))
    safe = np.where(singular, np.nan, denominator)
    ray = (k - ROOT_2 * q[..., None] * Nk) / safe[..., None]
    left = 2.0 * r[..., None] * (Nk - kNk[..., None] * ray)
    result = left[..., :, None] * Nk[..., None, :] - square[..., None, None] * np.eye(k.shape[-1])
    if gradient is not None:
        gradient = np.asarray(gradient, dtype=float)
        result = result - convection * (
            gradient - 2.0 * ray[..., :, None] * (k @ gradient)[..., None, :])
    return result, denominator / square


def growth_rates(k, N, coefficients, convection=0.0, gradient=None):
    """Return the eigenvalues (..., n - 1) of `tensor` on v.k = 0, largest real part first.

    ``k`` (..., n). They may be complex only with convection, and are not
    numbers where the denominator vanishes. For the primitive form they are the (..., n) rates of
    `relaxing_growth_rates`; with convection that raises `ValueError`.
    """
    if coefficients.model == "ngf_primitive" and gradient is None:
        return relaxing_growth_rates(k, N, coefficients)
    return modes(k, N, coefficients, convection, gradient)[0]


def relaxing_growth_rates(k, N, coefficients):
    """Return the growth rates (..., n) of the primitive form of NGF, largest real part first.

    The rate of the module's docstring, with y = 1/x = 1 + S (|k|^2 + T lambda), S = nu xi^2/(A d)^2
    and m = k^.N k^, becomes::

        (lambda + |k|^2) (e y + f) = 2 (1 - nu) |P N k|^2
        e = 1 - sqrt(2) mu m,    f = mu nu m/sqrt(2)

    which is a quadratic in lambda. In space -|k|^2 is a further rate, of a velocity normal to k
    and N k.

    Parameters
    ----------
    k : ndarray, (..., n)
    N : ndarray, (n, n)
    coefficients : Coefficients
        Those of ngf_primitive.

    Returns
    -------
    ndarray
        Real within (3.19). Not numbers where e, the denominator of (3.16) for fast changes,
        vanishes. Raises `ValueError` for k = 0.
    """
    k = np.asarray(k, dtype=float)
    square = (k * k).sum(axis=-1)
    if not np.all(square > 0.0):
        raise ValueError("wave vector: allowed is any but the zero vector")
    Nk = k @ N
    m = (k * Nk).sum(axis=-1) / square
    height = np.maximum((Nk * Nk).sum(axis=-1) / square - m**2, 0.0)
    values = np.stack(_relaxing_roots(square, m, height, coefficients), axis=-1)
    if k.shape[-1] == 3:
        viscous = np.where(np.isnan(values[..., :1]), np.nan, -square[..., None])
        values = np.concatenate([values, viscous], axis=-1)
    values = np.take_along_axis(values, np.argsort(-values.real, axis=-1), axis=-1)
    return values if np.nan_to_num(values.imag).any() else values.real


def _relaxing_roots(square, m, height, coefficients):
    """The roots of the quadratic of `relaxing_growth_rates`, complex, larger one first.

    ``height`` is |P N k^|^2. Neither root nor discriminant loses digits within (3.19): no terms
    of opposite sign are added, but for the constant term, which passes zero.
    """
    mu, nu, S = coefficients.mu, coefficients.nu, coefficients.spread
    e, f = 1.0 - ROOT_2 * mu * m, mu * nu * m / ROOT_2
    e = np.where(np.abs(e) <= 1e-12, np.nan, e)
    drive = 2.0 * (1.0 - nu) * height
    stored, steady = e * S * coefficients.relaxation, e * (1.0 + S * square) + f
    linear, constant = steady + stored * square, square * (steady - drive)
    root = np.sqrt((stored * square - steady)**2 + 4.0 * stored * square * drive + 0.0j)
    half = -(linear + np.where(linear < 0.0, -1.0, 1.0) * root) / 2.0
    with np.errstate(invalid="ignore"):  # where there is no wave vector or no e
        first, second = constant / half, half / stored
    swap = second.real > first.real
    return np.where(swap, second, first), np.where(swap, first, second)


def tensor_growth_rates(k, N, coefficients, convection=0.0, gradient=None):
    """Return the eigenvalues (..., n) of `tensor` itself, largest real part first.

    With convection these are what the paper calls the growth rates of (A 7). Unlike those of
    `growth_rates` their modes need not have v.k = 0. Without convection the two sets differ only
    by -|k|^2. Raises `ValueError` for the primitive form.
    """
    _no_relaxation(coefficients)
    k = np.asarray(k, dtype=float)
    A, _ = tensor(k, N, *coefficients.r_q((k * k).sum(axis=-1)), convection, gradient)
    lost = ~np.isfinite(A).all(axis=(-1, -2))
    values = np.linalg.eigvals(np.where(lost[..., None, None], 0.0, A))
    values = np.where(lost[..., None], np.nan, values)
    return np.take_along_axis(values, np.argsort(-values.real, axis=-1), axis=-1)


def modes(k, N, coefficients, convection=0.0, gradient=None):
    """Return growth rates (..., n - 1) and velocity modes (..., n - 1, n), as `growth_rates`.

    Raises `ValueError` for the primitive form.
    """
    _no_relaxation(coefficients)
    k = np.asarray(k, dtype=float)
    A, _ = tensor(k, N, *coefficients.r_q((k * k).sum(axis=-1)), convection, gradient)
    basis = transverse_basis(k)
    reduced = basis @ A @ np.swapaxes(basis, -1, -2)
    lost = ~np.isfinite(reduced).all(axis=(-1, -2))
    values, vectors = np.linalg.eig(np.where(lost[..., None, None], 0.0, reduced))
    values = np.where(lost[..., None], np.nan, values)
    order = np.argsort(-values.real, axis=-1)
    values = np.take_along_axis(values, order, axis=-1)
    vectors = np.take_along_axis(vectors, order[..., None, :], axis=-1)
    if np.isrealobj(values) or not np.abs(values.imag).any():
        values, vectors = values.real, vectors.real
    return values, np.swapaxes(vectors, -1, -2) @ basis


def transverse_basis(k):
    """Return n - 1 orthonormal rows (..., n - 1, n) that span the plane v.k = 0."""
    if k.shape[-1] == 2:
        unit = k / np.linalg.norm(k, axis=-1, keepdims=True)
        return np.stack([unit[..., 1], -unit[..., 0]], axis=-1)[..., None, :]
    # The Householder reflection that takes k to an axis takes the other axes to the plane.
    axis = np.argmax(np.abs(k), axis=-1)
    size = np.linalg.norm(k, axis=-1)
    e = np.eye(3)[axis]
    w = k + np.sign(np.take_along_axis(k, axis[..., None], -1)) * size[..., None] * e
    H = np.eye(3) - 2.0 * w[..., :, None] * w[..., None, :] / (w * w).sum(-1)[..., None, None]
    others = np.stack([(axis + 1) % 3, (axis + 2) % 3], axis=-1)
    return np.take_along_axis(H, others[..., None], axis=-2)


def pure_shear_growth(k1, k2, coefficients):
    """Return the growth rate (3.22) in pure shear, not a number where its denominator vanishes.

    Raises `ValueError` for the primitive form.
    """
    _no_relaxation(coefficients)
    square = k1**2 + k2**2
    r, q = coefficients.r_q(square)
    denominator = square - q * (k1**2 - k2**2)
    singular = np.abs(denominator) <= 1e-12 * (square + np.abs(q) * square)
    numerator = square**2 - q * square * (k1**2 - k2**2) - 4.0 * r * k1**2 * k2**2
    return -numerator / np.where(singular, np.nan, denominator)


def asymptotic_r_q(square, coefficients):
    """Return r0 and q0 for |k| -> infinity: (3.17) for NGF, the |k|^2 terms of (5.3) for IG."""
    _no_relaxation(coefficients)
    if coefficients.model == "ngf":
        return ((1.0 - coefficients.nu) / (coefficients.spread * square),
                coefficients.mu + 0.0 * square)
    if coefficients.model == "ig":
        return -square, -coefficients.mu * square / 2.0
    return coefficients.r_q(square)


def asymptotic_tensor(k, N, coefficients):
    """Return A_ik (..., n, n) for |k| -> infinity: (3.18) for NGF, (5.4) for IG."""
    _no_relaxation(coefficients)
    k = np.asarray(k, dtype=float)
    square = (k * k).sum(axis=-1)
    identity = square[..., None, None] * np.eye(k.shape[-1])
    if coefficients.model == "ngf":
        return -identity
    if coefficients.model == "li":
        return tensor(k, N, *coefficients.r_q(square))[0]
    Nk = k @ N
    kNk = (k * Nk).sum(axis=-1)
    left = k - (square / np.where(kNk == 0.0, np.nan, kNk))[..., None] * Nk
    factor = 2.0 * ROOT_2 / np.asarray(coefficients.mu)
    return factor[..., None, None] * left[..., :, None] * Nk[..., None, :] - identity


#: N of pure shear (3.20).
PURE_SHEAR = flow_direction(BASE_FLOWS["pure_shear"])


# Extrema over wave vectors (NGF in both forms, and LI): m = k^.N k^ = centre + y between the
# extreme principal values of N, half of whose distance is ``reach``.

def _extremes(N):
    """Centre and half distance of the extreme principal values of N."""
    values = np.linalg.eigvalsh(N)
    return (values[-1] + values[0]) / 2.0, (values[-1] - values[0]) / 2.0


def _posed(coefficients, N, values):
    """``values``, not numbers where mu_loc violates (3.19) and the criteria say nothing."""
    return np.where(coefficients.mu < limit_of_stress_ratio(N), values, np.nan)


def long_wave_excess(coefficients, N=PURE_SHEAR):
    """Return `pgran.material.laws.ill_posedness`, positive where some long wave grows."""
    return laws.ill_posedness(coefficients.mu, coefficients.nu, *_extremes(N))


def cutoff(coefficients, N=PURE_SHEAR):
    """Return the cut-off wave number, 0 where all are stable and inf for unstable LI.

    Not a number where (3.19) is violated. Raises `ValueError` for IG, which has none.

    The largest root x of 8 r^2 reach^2 + q^2 = 4 r (1 - sqrt(2) q centre), with r and
    q linear in x (see the module), gives |k|^2 = (1/x - 1)/(nu xi^2).
    """
    _no_ig(coefficients)
    centre, reach = _extremes(N)
    mu, nu = coefficients.mu, coefficients.nu
    # r = r1 x, q = mu + q1 x
    r1, q1 = 1.0 - nu, -mu * nu / 2.0
    a = 8.0 * r1**2 * reach**2 + q1**2 + 4.0 * ROOT_2 * centre * r1 * q1
    b = 2.0 * mu * q1 - 4.0 * r1 * (1.0 - ROOT_2 * centre * mu)
    discriminant = b**2 - 4.0 * a * mu**2
    x = (-b + np.sqrt(np.maximum(discriminant, 0.0))) / (2.0 * a)
    unstable = (x < 1.0) | (discriminant < 0.0)
    size = np.inf if coefficients.model == "li" else np.sqrt(
        np.maximum(1.0 / x - 1.0, 0.0) / coefficients.spread)
    return _posed(coefficients, N, np.where(unstable, size, 0.0))


def _ridge(square, coefficients, centre, reach, delay=0.0):
    """Largest growth over directions at |k|^2 = ``square``, and the y where it occurs.

    ``delay`` is T lambda of the primitive form.
    """
    r, q = coefficients.r_q(square + delay)
    p, e = ROOT_2 * q, 1.0 - ROOT_2 * q * centre
    root = e + np.sqrt(e**2 - (p * reach)**2)
    return square * (4.0 * r * reach**2 / root - 1.0), p * reach**2 / root


def fastest(coefficients, N=PURE_SHEAR, tolerance=1e-12):
    """Return wave number, growth rate and m = k^.N k^ of the fastest-growing wave vector.

    Not numbers where all wave vectors are stable, and for LI, which grows without bound.
    Raises `ValueError` for IG. The maximum
    along the ridge of `_ridge` is the root of its slope, bisected to ``tolerance``.

    For the primitive form the ridge is that of `_relaxing_ridge`. It is the solution lambda of
    lambda = ridge(|k|^2, T lambda), and the ridge falls with T lambda, so that at its maximum
    the slope at fixed T lambda is zero too.
    """
    centre, reach = _extremes(N)
    top = np.asarray(cutoff(coefficients, N) + 0.0 * coefficients.relaxation)
    low, high = np.zeros_like(top), np.where(np.isfinite(top), top, np.nan)**2
    unstable = np.isfinite(high) & (top > 0.0)
    for _ in range(int(np.ceil(np.log(tolerance) / np.log(0.5))) + 2):
        middle = (low + high) / 2.0
        delay = coefficients.relaxation * _relaxing_ridge(middle, coefficients, centre, reach)[0]
        rising = _ridge_slope(middle, coefficients, centre, reach, delay) > 0.0
        low, high = np.where(rising, middle, low), np.where(rising, high, middle)
    square = np.where(unstable, (low + high) / 2.0, np.nan)
    rate, y = _relaxing_ridge(square, coefficients, centre, reach)
    return np.sqrt(square), rate, centre + y


def _relaxing_ridge(square, coefficients, centre, reach):
    """`_ridge`, for the primitive form too, whose direction depends on the growth rate.

    The direction is best for the growth rate of the round before, and the growth rate is that of
    the direction. A direction that is nearly the best one has nearly the largest rate, so this
    converges as Newton's method does. It starts at 0 and rises from the second round on.
    """
    if coefficients.model != "ngf_primitive":
        return _ridge(square, coefficients, centre, reach)
    rate = np.zeros_like(square)
    for _ in range(ROUNDS):
        _, y = _ridge(square, coefficients, centre, reach, coefficients.relaxation * rate)
        rate = _relaxing_roots(square, centre + y, reach**2 - y**2, coefficients)[0].real
    return rate, y


def _ridge_slope(square, coefficients, centre, reach, delay=0.0):
    """Derivative of `_ridge` with respect to |k|^2 at fixed ``delay``."""
    r, q = coefficients.r_q(square + delay)
    x = coefficients.share(square + delay)
    dx = -coefficients.spread * x**2
    dr, dq = (1.0 - coefficients.nu) * dx, -coefficients.mu * coefficients.nu * dx / 2.0
    p, e = ROOT_2 * q, 1.0 - ROOT_2 * q * centre
    dp, de = ROOT_2 * dq, -ROOT_2 * dq * centre
    inner = np.sqrt(e**2 - (p * reach)**2)
    root = e + inner
    droot = de + (e * de - reach**2 * p * dp) / inner
    return (4.0 * r * reach**2 / root - 1.0
            + square * 4.0 * reach**2 * (dr / root - r * droot / root**2))


def unstable_directions(coefficients, N=PURE_SHEAR):
    """Return the range (m_low, m_high) of k^.N k^ that is unstable for |k| -> 0.

    Roots of 2 r (reach^2 - y^2) - 1 + sqrt(2) q (centre + y), which bound the unstable
    directions of LI at any |k| and contain those of NGF. Not numbers where stable.
    """
    _no_ig(coefficients)
    centre, reach = _extremes(N)
    r, q = coefficients.r_q(np.zeros_like(coefficients.mu))
    p, e = ROOT_2 * q, 1.0 - ROOT_2 * q * centre
    discriminant = p**2 + 8.0 * r * (2.0 * r * reach**2 - e)
    root = _posed(coefficients, N, np.sqrt(np.where(discriminant > 0.0, discriminant, np.nan)))
    return centre + (p - root) / (4.0 * r), centre + (p + root) / (4.0 * r)


def directions(m, N):
    """Return the two unit wave vectors (2, n) with k^.N k^ = ``m`` between extreme principal axes.

    They are mirror images of each other about these axes. ``m`` is a number, ``N`` is (n, n).
    """
    values, vectors = np.linalg.eigh(N)
    share = np.clip((m - values[0]) / (values[-1] - values[0]), 0.0, 1.0)
    along, across = np.sqrt(share) * vectors[:, -1], np.sqrt(1.0 - share) * vectors[:, 0]
    return np.array([along + across, along - across])


def direction_angle(m, N):
    """Return the smaller angle (degrees, 0 to 90) of the `directions` with the x1 axis."""
    found = np.array([directions(value, N) for value in np.ravel(m)])
    angles = np.degrees(np.arctan2(np.linalg.norm(found[..., 1:], axis=-1),
                                   np.abs(found[..., 0])))
    return angles.min(axis=-1).reshape(np.shape(m))


def critical_inertial_numbers(law, I_range=I_RANGE, N=PURE_SHEAR):
    """Return the inertial numbers (m,) at which instability of any wave vector begins or ends.

    They are the sign changes of `long_wave_excess` within ``I_range``, up to the bound of (3.19).
    """
    roots = laws.sign_changes(
        lambda I: long_wave_excess(Coefficients.of(law, "li", I), N), *I_range)
    return roots[law.stress_ratio(roots)[0] < limit_of_stress_ratio(N)]


def ill_posed_ranges(law, I_range=(1e-12, 1e4)):
    """Return the ranges (m, 2) of inertial numbers in which LI is ill-posed in plane flow.

    There C(I) > 0, see `pgran.material.laws.ill_posedness`. The first range begins at 0 where
    C > 0 at the lower end of ``I_range``, and the last one ends at infinity where C > 0 at the
    upper end.
    """
    def C(I):
        return laws.ill_posedness(*laws.sensitivity(law, I))

    edges = laws.sign_changes(C, *I_range)
    if C(I_range[0]) > 0.0:
        edges = np.concatenate([[0.0], edges])
    if C(I_range[1]) > 0.0:
        edges = np.concatenate([edges, [np.inf]])
    return edges.reshape(-1, 2)


def _no_ig(coefficients):
    if coefficients.model == "ig":
        raise ValueError("the growth of the IG model has no bound, so that it has neither a "
                         "cut-off nor a fastest wave vector; allowed are the models ngf and li")


def _no_relaxation(coefficients):
    if coefficients.model == "ngf_primitive":
        raise ValueError("the model ngf_primitive: its theory leaves out convection and turning "
                         "wave vectors; allowed are the models ngf, li and ig")
