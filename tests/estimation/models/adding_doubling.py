"""R_d and exit radiance of half spaces by adding and doubling: the golden numbers of monte_carlo_truth_test.cpp, and
those of held_back/make_session.py.

Plane-parallel radiative transfer in 2 x 100 streams either side of the critical angle, normal incidence,
Henyey-Greenstein in 200 Legendre terms, Fresnel inside. Gives Chandrasekhar's anchors (design/science.md)
to 2e-7. Needs numpy; usage: adding_doubling.py
"""
import numpy as np

STREAMS = 100


def reflectance(x, g, eta, exit_degrees=(0, 45)):
    """Per transmitted flux: R_d at x = sigma_a/sigma_s', and h = exit radiance over Lambertian at each angle, 0 first."""
    critical = np.sqrt(1 - 1 / eta**2) if eta > 1 else 0.3
    node, weight = np.polynomial.legendre.leggauss(STREAMS)
    node, weight = (node + 1) / 2, weight / 2
    # The last stream is the beam, too narrow to matter otherwise; others look where h is wanted.
    looks = np.sqrt(1 - np.sin(np.radians(exit_degrees[::-1]))**2 / eta**2)
    mu = np.concatenate([critical * node, critical + (1 - critical) * node, looks])
    w = np.concatenate([critical * weight, (1 - critical) * weight, np.full(len(looks), 1e-10)])
    albedo = 1 / (1 + x * (1 - g))
    legendre = np.ones((2 * STREAMS, len(mu)))
    legendre[1] = mu
    for n in range(2, 2 * STREAMS):
        legendre[n] = ((2 * n - 1) * mu * legendre[n - 1] - (n - 1) * legendre[n - 2]) / n
    order = np.arange(2 * STREAMS)
    c = (2 * order + 1) * g**order if g else (order == 0) * 1.0
    forward = (legendre * c[:, None]).T @ legendre
    backward = (legendre * (c * (-1.0) ** order)[:, None]).T @ legendre
    a = -np.diag(1 / mu) + albedo / 2 * forward * w / mu[:, None]
    b = albedo / 2 * backward * w / mu[:, None]
    one, thin = np.eye(len(mu)), 2.0**-26
    t = one + thin * a + thin**2 / 2 * (a @ a + b @ b)
    r = thin * b + thin**2 / 2 * (a @ b + b @ a)
    for _ in range(26 + 20):
        between = np.linalg.inv(one - r @ r)
        r, t = r + t @ between @ r @ t, t @ between @ t
    sine2 = eta**2 * (1 - mu**2)
    outside = np.sqrt(np.maximum(0, 1 - sine2))
    s = (eta * mu - outside) / (eta * mu + outside)
    p = (eta * outside - mu) / (eta * outside + mu)
    inner = np.where(sine2 >= 1, 1, (s**2 + p**2) / 2) if eta > 1 else np.zeros(len(mu))
    beam = np.zeros(len(mu))
    beam[-1] = 1 / w[-1]
    up = np.linalg.solve(one - r * inner, r @ beam)
    total = np.sum(w * mu * (1 - inner) * up)
    # Radiance leaves with 1/eta^2; a Lambertian surface has exitance/pi, here total * 2 of it.
    h = (1 - inner) * up / eta**2 / (2 * total)
    return total, *h[:-len(looks) - 1:-1]


if __name__ == "__main__":
    for g, eta in [(0.8, 1.4), (0.9, 1.4), (0, 1.4), (0.8, 1.3), (0.8, 1.5)]:
        for x in (1e-6, 1e-4, 1e-3, 0.01, 0.1, 1, 10):
            total, normal, slanted = reflectance(x, g, eta)
            print(f"      {{{eta}, {g}, {x:g}, {total:.7f}, {normal:.5f}, {slanted:.5f}}},")
    for name, sigma_a, sigma_s in [("red", 0.0525, 1.2814), ("green", 0.1653, 1.5), ("blue", 0.2216, 1.1248)]:
        h = reflectance(sigma_a / sigma_s, 0.8, 1.4, range(0, 90, 15))[1:]
        print(f'    "{name}_cheek": [' + ", ".join(f"{value:.4f}" for value in h) + "],")
