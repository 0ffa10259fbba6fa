"""Reports of tuning."""

from __future__ import annotations

from collections.abc import Sequence

from linkside.report import Input, Page, Verdict
from linkside.report.page import Part

from .noise_likelihood import Tuning
from .observer_front import Front

TRY = "Estimate a recording that was not used here: linkside estimate robot.yaml other.parquet --tuning tuning.yaml …"


def page(tuned: Tuning | Front, inputs: Sequence[Input]) -> Page:
    """Lay out the report."""
    return _of_noise(tuned, inputs) if isinstance(tuned, Tuning) else _of_observer(tuned, inputs)


def _of_noise(tuned: Tuning, inputs: Sequence[Input]) -> Page:
    gain = tuned.log_likelihood_after - tuned.log_likelihood_before
    reasons = [f"Log-likelihood {tuned.log_likelihood_before:.1f} before, {tuned.log_likelihood_after:.1f} after."]
    if tuned.at_bound:
        reasons.insert(0, f"At the edge of what was allowed: {', '.join(tuned.at_bound)}.")
    if max(tuned.widening) > 1:
        reasons.append("Innovations are correlated in time, as errors of a model are: values were widened by them.")
    verdict = Verdict("good", "The noise after tuning makes the recordings more likely", tuple(reasons))
    if tuned.at_bound:
        verdict = Verdict("doubtful", "The most likely noise is at the edge of what was allowed", tuple(reasons))
    elif gain <= 0:
        verdict = Verdict("doubtful", "No noise makes the recordings more likely than that before", tuple(reasons))
    if not tuned.accepted:
        verdict = Verdict("bad", "The noise after tuning is not to be used", (*tuned.objections, *reasons))
    facts = [("NIS per reading", f"{tuned.nis_before:.3g} before, {tuned.nis_after:.3g} after")]
    steps = [TRY, *(["Calibrate the robot first: linkside calibrate robot.yaml log.parquet"] if tuned.at_bound else [])]
    return Page("Noise tuned by recordings", verdict, facts, steps, [("Values", [tuned.to_text()])], inputs)


def _of_observer(front: Front, inputs: Sequence[Input]) -> Page:
    position, velocity, torsion, noise = front.ratios[front.recommended]
    changes = f"Errors of position, velocity, torsion: {position:.3g}, {velocity:.3g}, {torsion:.3g} of those before."
    verdict = Verdict(
        "open", "A compromise between errors and noise", (changes, f"Noise is {noise:.3g} times that before.")
    )
    parts: list[Part] = [front.to_text(), ("Errors over noise, in multiples of those before", front.figure())]
    return Page("Poles tuned by recordings", verdict, [], [TRY], [("Pareto front", parts)], inputs)
