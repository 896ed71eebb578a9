# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
#       format_version: '1.3'
#       jupytext_version: 1.19.6
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Proven optima: shutter codes as Newman polynomials
#
# **Question.** How well can a shutter of n chips keep every frequency of a straight motion?
# **Answer.** As well as a Newman polynomial, one with coefficients 0 and 1, can stay away from
# zero on the unit circle. The best ones are known by exhaustive search up to 48 chips
# ([table](../docs/optima.md)). The smallest modulus first exceeds 2 at 39 chips, degree 38.

# %% [markdown]
# ## Why the unit circle
#
# A code has n chips, $c_k = 1$ where the shutter is open. Along a straight uniform motion of $L$
# px it keeps the share
# px it keeps the share $$|H(f)| =
# \frac{1}{n}\,\Bigl|\mathrm{sinc}\,\frac{fL}{n}\Bigr|\;|P(z)|,\qquad P(z)=\sum_k c_k z^k,
# \quad z = e^{-2\pi i f L/n}$$ of a frequency $f$ in cycles/px. The sinc belongs to the chip,
# whatever the code is. As $f$ runs over the camera's band,
# exactly if $P$ has no zero on the circle.

# %%
import numpy as np
from matplotlib import pyplot as plt

import cep

barker = cep.load_code("barker-13")
L, n = 26.0, barker.chips
f = np.linspace(0, 0.5, 800)
z = np.exp(-2j * np.pi * f * L / n)
formula = np.abs(np.sinc(f * L / n) * np.polyval(barker.array[::-1], z)) / n
measured = cep.mtf(cep.Trajectory.straight(L), barker, f, 0 * f)
assert np.allclose(measured, formula, atol=1e-12)

# %% [markdown]
# Left: the zeros of three polynomials. The open shutter $1 + z + \dots + z^{12}$ has all of its
# zeros on the circle, the roots of unity, and each is a frequency lost for good. A good code keeps
# its zeros away from the circle. Right: the modulus along the circle.

# %%
codes = {"open shutter": "1" * 13, "a random code": "1101100010110", "Barker-13": barker.bits}
figure, (plane, circle) = plt.subplots(1, 2, figsize=(11, 4.6), layout="constrained")
angle = np.linspace(0, np.pi, 2000)
plane.plot(np.cos(2 * angle), np.sin(2 * angle), color="0.7", lw=1)
for (name, bits), mark in zip(codes.items(), "ox^", strict=True):
    coefficients = np.array([int(bit) for bit in bits], float)
    roots = np.roots(np.trim_zeros(coefficients)[::-1])
    off = np.abs(np.abs(roots) - 1).min()
    plane.plot(
        roots.real,
        roots.imag,
        mark,
        ms=6,
        fillstyle="none",
        label=f"{name}: {off:.2f} from the circle",
    )
    circle.plot(
        angle / (2 * np.pi), np.abs(np.polyval(coefficients[::-1], np.exp(1j * angle))), label=name
    )
plane.set(
    aspect="equal",
    xlim=(-1.9, 1.9),
    ylim=(-1.9, 1.9),
    xlabel="Re z",
    ylabel="Im z",
    title="zeros of P",
)
plane.legend(loc="upper left", fontsize=8)
circle.axhline(1.362373, color="0.5", lw=1, ls=":")
circle.set(xlabel="cycles per chip", ylabel="|P|, chips", title="modulus on the unit circle")
circle.legend()
unity = np.roots(np.ones(13))
assert np.allclose(np.abs(unity), 1)

# %% [markdown]
# ## All codes of at most 12 chips, in plain numpy
#
# There are only 4095 of them. Each is evaluated on 4096 points of the circle; `cep.certify` then
# closes the gap between the points for the winner. Parseval limits the modulus from above: its
# mean square on the circle is the number of open chips k, so the minimum is at most $\sqrt{k}$.

# %%
most = 12
bits = (np.arange(1, 2**most)[:, None] >> np.arange(most)) & 1
modulus = np.abs(np.fft.rfft(bits, 4096, axis=1))
lowest = modulus.min(axis=1)
length = most - np.argmax(bits[:, ::-1], axis=1)
assert (lowest <= np.sqrt(bits.sum(axis=1)) + 1e-9).all()
by_hand = {m: lowest[length <= m].max() for m in range(3, most + 1)}
print({m: round(float(value), 4) for m, value in by_hand.items()})

# %% [markdown]
# No code of 3 to 12 chips exceeds 1, which a single open chip has as well. The search of this
# package comes to the same minima. It discards a code at the first frequency where it falls below
# the best one so far, and certifies the winner.


# %%
def best_of(chips):
    straight = cep.Trajectory.straight(float(chips))
    problem = cep.SearchProblem.along(straight, chips=chips)
    return cep.optimize(problem, method="exact", threads=1, photographs=())  # the code alone


for chips in (8, 10, 12):
    proven = best_of(chips)
    assert proven.search.stopped == "proven"
    assert abs(proven.certificate.lower - by_hand[chips]) < 1e-5

# %% [markdown]
# ## Up to 24 chips
#
# The minimum grows in steps. Thirteen chips suffice for Barker's code, which nothing beats before
# 21.

# %%
table = {
    13: 1.362373,
    14: 1.362373,
    20: 1.362373,
    21: 1.403101,
    22: 1.455101,
    24: 1.575471,
}  # docs/optima.md
known = {
    25: 1.575471,
    26: 1.724079,
    29: 1.899892,
    36: 1.931778,
    38: 1.954516,
    39: 2.018175,
    40: 2.022829,
}
known |= {42: 2.038368, 43: 2.076868, 44: 2.173847, 48: 2.244274}
found = {chips: best_of(chips) for chips in table}
for chips, proven in found.items():
    lower, upper = proven.certificate.lower, proven.certificate.upper
    print(f"{chips:3d} chips  {lower:.6f}  {proven.code.bits}")
    assert lower <= table[chips] + 1e-6
    assert upper >= table[chips] - 1e-6
    assert cep.verify(proven.certificate)

figure, axes = plt.subplots(figsize=(7.5, 4), layout="constrained")
axes.step(
    [12, *table, *known, 49],
    [1, *table.values(), *known.values(), 2.244274],
    where="post",
    color="0.8",
    label="table",
)
axes.plot(list(by_hand), list(by_hand.values()), ".", label="all codes, in numpy")
axes.plot(
    list(found),
    [p.certificate.lower for p in found.values()],
    "o",
    fillstyle="none",
    label="proven here",
)
axes.axhline(2, color="0.5", lw=1, ls=":")
axes.set(
    xlabel="chips n",
    ylabel="largest minimum of |P|, chips",
    ylim=(0.9, 2.35),
    title="the best code of at most n chips",
)
_ = axes.legend(loc="upper left")

# %% [markdown]
# ## Beyond 2 at degree 38
#
# Whether a Newman polynomial can stay above 2 on the whole circle was settled by enumeration: the
# first has degree 38 ([arXiv 1910.13994](https://arxiv.org/abs/1910.13994)). The certificate below
# is a proof that this one does, checked by a second program that shares no code with the first.
# That no shorter one does takes the search of a minute: `cep optimize --linear 38 --chips 38
# --method exact`.

# %%
first = cep.ShutterCode("100100100100111010000111001110111010001")
certificate = cep.certify(first)
print(f"degree {first.chips - 1}: {certificate.lower:.6f} <= min |P| <= {certificate.upper:.6f}")
assert certificate.lower > 2
assert cep.verify(certificate)

# %% [markdown]
# For a shutter the light counts too: of equal minima the table takes the brightest code. And for a
# path that is not straight there is no polynomial: `cep.certify(code, path)` then bounds |H| over
# the two-dimensional band.
