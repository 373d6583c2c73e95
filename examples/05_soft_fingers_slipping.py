"""Three soft fingers hold a ball, and let go of it slowly: when does it slip?

Each finger carries a third of the weight by friction, so they slip where mu N = m g / 3. The simulation's steps are
20 ms; the instant is found inside a step.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import holdfast as hf
from holdfast.control.torque_schedule import TorqueSchedule
from holdfast.robots.mechanisms import FINGERTIP, three_finger_hand
from holdfast.view.figure_style import DPI
from holdfast.view.plots import friction_margin_figure

OUT = Path(__file__).parent / "out"
FIRM, WEAK = 2.0, 0.2  # normal force of each finger, at the beginning and at the end [N]
DURATION = 0.5  # s


def main(out: Path = OUT) -> dict[str, float]:
    """Return the numbers that this example prints."""
    hand = three_finger_hand(mass=0.15, radius=0.035)
    chain, state = hf.assemble(*hand)

    # Torques for a large and a small internal force, joined by a straight line in time.
    firm, weak = (hf.holding_torques(chain, state, internal_force=force) for force in (FIRM, WEAK))
    loosening = TorqueSchedule.linear([0.0, DURATION], [firm, weak])
    margin = hf.forces.grasp_margins(chain, state, hf.forward_dynamics(chain, state, firm).grasp_wrench)

    # As long as it holds: what happens when it no longer does is `on_slip`. "record" goes on as if it held.
    stopped = hf.simulate(chain, state, loosening, DURATION, step=0.02)
    recorded = hf.simulate(chain, state, loosening, DURATION, step=0.02, on_slip="record")
    slip = stopped.occurrences[0]

    mu, weight = FINGERTIP.mu, -hand.held_object.mass * chain.gravity[2]
    needed = weight / 3 / mu
    expected = DURATION * (FIRM - needed) / (FIRM - WEAK)

    figure = friction_margin_figure(chain, recorded)
    out.mkdir(parents=True, exist_ok=True)
    figure.savefig(out / "05_soft_fingers_slipping.png", dpi=DPI)

    print(f"margin of each finger at {FIRM} N: {np.round(margin, 4)} N; at least {needed:.4f} N are needed")
    print(f"{stopped.stopped}")
    print(f"closed form: {expected:.9f} s, off by {abs(slip.t - expected):.1e} s")
    return {
        "margin": float(margin.min()),
        "margin_expected": mu * FIRM - weight / 3,
        "slip": slip.t,
        "slip_expected": expected,
        "slipped": len({one.name for one in recorded.occurrences if one.kind == "violation"}),
    }


if __name__ == "__main__":
    main()
