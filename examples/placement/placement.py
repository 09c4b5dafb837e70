"""Where one sensor belongs on a heated spindle and on a column (Ni 1997, Fig. 7 to 9).

    python examples/placement/placement.py --out out/placement

Prints the place of least nonlinearity for losses, ends and horizons, the closed form of the lag-free place, and how
a straight line and polynomials fitted on one warm-up fare on a random duty cycle. Writes the curves as SVG.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import nonlinearity
import numpy as np
from column import Column

from errpipe import jsonfile
from errpipe.fitting import placement
from errpipe.reporting import svg
from errpipe.simulation import spindle_bar
from errpipe.simulation.spindle_bar import Bar

HORIZONS = (0.25, 0.5, 1.0, 2.0, 5.0)
CASES = {
    "insulated": Bar(0.0),
    "losing end, Be 1": Bar(0.0, 1.0),
    "cold end": Bar(0.0, np.inf),
    "loss 0.5": Bar(0.5),
    "loss 1": Bar(1.0),
    "loss 2": Bar(2.0),
    "loss 4": Bar(4.0),
    "loss 9": Bar(9.0),
    "loss 1, Be 1": Bar(1.0, 1.0),
    "loss 4, Be 1": Bar(4.0, 1.0),
}
TRIED = (0.02, 0.35, 0.40, 0.98)


def warm_up(bar: Bar, until: float, steps: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """Temperatures and growth of a warm-up at constant flux, cold to Fo = until."""
    theta = bar.respond(np.linspace(0.0, until, steps + 1)[1:], np.ones(steps))
    return theta, spindle_bar.growth(theta)


def places() -> dict[str, dict[str, list[float]]]:
    """Case -> criterion -> place per horizon, in bar lengths from the heat."""
    out = {}
    for name, bar in CASES.items():
        runs = [warm_up(bar, until) for until in HORIZONS]
        out[name] = {
            how: [nonlinearity.finest(bar.places, nonlinearity.linearity(t, g, how).residual) for t, g in runs]
            for how in ("rms", "max")
        }
    return out


def extrapolate(seed: int = 1) -> dict[str, dict[str, float]]:
    """Place -> model -> rms on a random duty cycle as a share of its range, fitted on one warm-up to Fo 0.5."""
    bar = Bar(1.5)
    theta, grown = warm_up(bar, 0.5, 200)
    times, flux = spindle_bar.random_duty(30, 20, seed)
    duty = bar.respond(times, flux)
    later = spindle_bar.growth(duty)
    out = {}
    for x in TRIED:
        k = int(np.argmin(np.abs(bar.places - x)))
        out[f"{x:g}"] = {
            name: nonlinearity.extrapolation(theta[:, k], grown, duty[:, k], later, degree)
            for degree, name in ((1, "line"), (2, "parabola"), (3, "cubic"))
        }
    return out


def column(seed: int = 1) -> dict[str, object]:
    """On a column: the height at which the difference front less back tells the lean best, and how it extrapolates."""
    body = Column()
    times = np.arange(1, 181) * 120.0
    field = body.respond(times, np.ones(times.size))
    lean = body.lean(field)
    pair = field[:, :, 0] - field[:, :, -1]
    linearity = nonlinearity.linearity(pair, lean)
    later = np.arange(1, 301) * 120.0
    duty = body.respond(later, np.repeat(np.random.default_rng(seed).uniform(0.0, 2.5, 20), 15))
    new = duty[:, :, 0] - duty[:, :, -1]
    heights = body.places()[0][:, 0]
    single = nonlinearity.linearity(field.reshape(times.size, -1), lean)
    return {
        "heights": heights.tolist(),
        "nonlinearity": linearity.residual.tolist(),
        "best_height": float(heights[linearity.best]),
        "best_single_sensor_nonlinearity": float(single.residual.min()),
        "extrapolation_line": [
            nonlinearity.extrapolation(pair[:, k], lean, new[:, k], body.lean(duty), 1) for k in range(heights.size)
        ],
    }


def curves(until: float = 1.0) -> str:
    """Growth against reading at three places for three fluxes: one straight line only at the strategic place."""
    bar = Bar(1.5)
    with svg.figure(columns=3) as (canvas, axes):
        for axis, x in zip(axes, (0.02, 0.37, 0.98), strict=True):
            k = int(np.argmin(np.abs(bar.places - x)))
            for flux, shade in ((0.5, svg.FLOOR), (1.0, svg.AFTER), (2.0, svg.BEFORE)):
                theta, grown = warm_up(bar, until)
                axis.plot(flux * theta[:, k], flux * grown, color=shade, label=f"flux {flux:g}")
            axis.set_title(f"x = {x:g} L")
            axis.set_xlabel("reading")
        axes[0].set_ylabel("growth")
        axes[0].legend()
        return svg.to_svg(canvas, "Growth against reading at three places")


def main() -> None:
    """Print the figures and write the curves."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/placement"))
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    nodes = places()
    print(f"{'place of least nonlinearity, rms (max)':40s}" + "".join(f"{'Fo ' + str(h):>14s}" for h in HORIZONS))
    for name, by in nodes.items():
        cells = [f"{r:.3f} ({m:.3f})" for r, m in zip(by["rms"], by["max"], strict=True)]
        print(f"{name:40s}" + "".join(f"{c:>14s}" for c in cells))
    free = {f"{loss:g}": placement.lag_free_place(loss) for loss in (0.0, 1.0, 4.0)}
    print("lag-free place by loss:", {k: round(v, 4) for k, v in free.items()})
    far = extrapolate()
    for x, by in far.items():
        cells = ", ".join(f"{name} {100 * v:.1f} %" for name, v in by.items())
        print(f"sensor at {x} L, of the range of a random duty: {cells}")
    body = column()
    best = int(np.argmin(body["nonlinearity"]))
    print(
        f"column: front less back at {body['best_height']:.2f} of the height, nonlinearity "
        f"{100 * body['nonlinearity'][best]:.1f} %, on a random duty {100 * body['extrapolation_line'][best]:.1f} % "
        f"(worst height {100 * max(body['extrapolation_line']):.0f} %)"
    )
    document = {"placement": 1, "places": nodes, "lag_free": free, "extrapolation": far, "column": body}
    jsonfile.write(out / "placement.json", document)
    jsonfile.write_text(out / "curves.svg", curves())


if __name__ == "__main__":
    main()
