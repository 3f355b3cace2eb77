"""SprTurtleBot on virtual bodies: the step response of its wheels, and the error of its odometry.

    .venv/bin/python bench/drive.py [--quick] [--json]

For each seed there is a rover with motors, wheels and track within their tolerances. Its gains come
from `uros.control.autotune`, its sizes from `uros.control.calibrate` with two squares whose poses
are measured to 3 mm and half a degree. Then it drives a square of 1 m, closed-loop by its own
odometry. The formulas of the Spresense document run beside it, on the edges of the same encoders.
All is in virtual time: the figures are the same on every machine. The plot is
build/bench/drive.png.

Errors of the position are shares of the path, which is 4 m; those of the heading are degrees. The
document's heading is that of its quaternion.
"""

from __future__ import annotations

import json
import math
import random
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from support.driving import Answer, Car, answers, calibrate, square, tune, use  # noqa: E402

PLOT = ROOT / "build" / "bench" / "drive.png"
PATH = 4.0
STEP = 0.3  # m/s

# The goals.
SETTLED, OVERSHOOT, METRES, DEGREES = 0.6, 0.10, 0.02, 3.0


class DocumentOdometry:
    """The program of the sub core, as printed.

    Each period counts edges without a sign, and uses the sign of the target.
    """

    RADIUS = 0.0325
    EDGE = 9.0  # degrees
    D = 0.134

    def __init__(self) -> None:
        self.x = self.y = self.theta = 0.0
        self.qz = self.qw = 0.0  # it sends nothing before the first motion

    def update(self, right: int, left: int, right_target: float, left_target: float) -> None:
        """Add the edges of a period."""
        if not right and not left:
            return
        right_way = math.copysign(right * self.EDGE * math.pi / 180 * self.RADIUS, right_target)
        left_way = math.copysign(left * self.EDGE * math.pi / 180 * self.RADIUS, left_target)
        last = self.theta
        self.theta += (right_way - left_way) / (2 * self.D)
        self.theta = min(self.theta, 2 * math.pi)
        # The old heading plus half of the new one, not the mean of both.
        self.x += (right_way + left_way) / 2 * math.cos(last + self.theta / 2)
        self.y += (right_way + left_way) / 2 * math.sin(last + self.theta / 2)
        half = self.theta / 2
        self.qz = math.sin(half) - math.cos(half)
        self.qw = math.cos(half) + math.sin(half)

    @property
    def heading(self) -> float:
        """The heading of its quaternion, of any norm."""
        return 2 * math.atan2(self.qz, self.qw)


class Drive:
    """One square: the paths, and the errors at its end."""

    def __init__(self, car: Car, clockwise: bool) -> None:
        self.car = car
        self.document = DocumentOdometry()
        self.true: list[tuple[float, float]] = [(0.0, 0.0)]
        self.ours: list[tuple[float, float]] = [(0.0, 0.0)]
        self.theirs: list[tuple[float, float]] = [(0.0, 0.0)]
        self._counts = [0, 0]
        car.on_step = self._record
        for side, encoder in enumerate(car.rover.encoders):
            encoder.on_edge = self._counted(side, encoder.on_edge)
        square(car, clockwise=clockwise)
        metres, degrees = car.error()
        self.metres, self.degrees = metres / PATH, abs(degrees)
        x, y, theta = car.pose
        document = self.document
        self.their_metres = math.hypot(document.x - x, document.y - y) / PATH
        self.their_degrees = abs(math.degrees(math.remainder(document.heading - theta, math.tau)))
        self.their_norm = math.hypot(document.qz, document.qw)

    def _counted(self, side: int, on_edge: object) -> object:
        def both(t_us: int, level: int) -> None:
            self._counts[side] += 1
            on_edge(t_us, level)  # type: ignore[operator]

        return both

    def _record(self) -> None:
        car = self.car
        drive = car.drive
        targets = drive.v + drive.d * drive.w, drive.v - drive.d * drive.w
        self.document.update(*self._counts, *targets)
        self._counts[:] = 0, 0
        self.true.append((car.rover.x, car.rover.y))
        self.ours.append((car.odometry.x, car.odometry.y))
        self.theirs.append((self.document.x, self.document.y))


def measure(seed: int) -> tuple[dict[str, object], Drive, tuple[Answer, Answer]]:
    """Measure the body of one seed: (figures, drive, step responses)."""
    source = random.Random(seed)

    def person(length: float) -> float:
        return length + source.uniform(-0.003, 0.003)

    car = Car(seed)
    tuning = tune(car)
    if tuning.fault:
        raise SystemExit(f"seed {seed}: {tuning.fault}")
    pids = car.drive.right_pid, car.drive.left_pid
    wheels = answers(Car(seed, pids), STEP)
    untuned = answers(Car(seed), STEP)
    sizes = calibrate(lambda: Car(seed, pids), person)
    plain = Drive(Car(seed, pids), bool(seed & 1))
    car = Car(seed, pids)
    use(car, sizes)
    drive = Drive(car, bool(seed & 1))
    figures: dict[str, object] = {
        "seed": seed,
        "settled_s": round(max(wheel.settled for wheel in wheels), 3),
        "overshoot": round(max(wheel.overshoot for wheel in wheels), 4),
        "untuned_settled_s": round(max(wheel.settled for wheel in untuned), 3),
        "untuned_overshoot": round(max(wheel.overshoot for wheel in untuned), 4),
        "gains": {
            side: {
                "kp": round(pid.kp),
                "ki": round(pid.ki),
                "dead_zone": round(pid.dead_zone, 1),
                "kf": round(pid.kf),
                "lag": round(pid.lag, 3),
            }
            for side, pid in zip(("right", "left"), pids, strict=True)
        },
        "position": round(drive.metres, 4),
        "heading": round(drive.degrees, 2),
        "uncalibrated_position": round(plain.metres, 4),
        "uncalibrated_heading": round(plain.degrees, 2),
        "document_position": round(plain.their_metres, 4),
        "document_heading": round(plain.their_degrees, 1),
        "document_quaternion": round(plain.their_norm, 3),
    }
    return figures, drive, wheels


def plot(drive: Drive, wheels: tuple[Answer, Answer]) -> None:
    """Plot the square and the step response of one seed."""
    from PIL import Image, ImageDraw, ImageFont

    big = 2  # drawn twice as large, for smooth lines
    wide, high = 1120, 560
    image = Image.new("RGB", (wide * big, high * big), "white")
    draw = ImageDraw.Draw(image)
    font = ImageFont.load_default(15 * big)
    black, grey = (30, 30, 30), (205, 205, 205)
    blue, orange, red = (31, 90, 180), (225, 130, 20), (200, 40, 40)

    def text(x: float, y: float, words: str, colour: tuple[int, int, int] = black) -> None:
        draw.text((x * big, y * big), words, colour, font)

    class Axes:
        def __init__(self, box: tuple[int, int, int, int], xs: tuple, ys: tuple) -> None:
            self.box, self.xs, self.ys = box, xs, ys

        def at(self, x: float, y: float) -> tuple[float, float]:
            left, top, right, bottom = self.box
            across = (x - self.xs[0]) / (self.xs[-1] - self.xs[0])
            up = (y - self.ys[0]) / (self.ys[-1] - self.ys[0])
            return (left + across * (right - left)) * big, (bottom - up * (bottom - top)) * big

        def grid(self, unit_x: str, unit_y: str) -> None:
            for x in self.xs:
                draw.line((self.at(x, self.ys[0]), self.at(x, self.ys[-1])), grey, big)
                where = self.at(x, self.ys[0])
                draw.text((where[0], where[1] + 6 * big), f"{x:g}", black, font, anchor="ma")
            for y in self.ys:
                draw.line((self.at(self.xs[0], y), self.at(self.xs[-1], y)), grey, big)
                where = self.at(self.xs[0], y)
                draw.text((where[0] - 8 * big, where[1]), f"{y:g}", black, font, anchor="rm")
            text(self.box[2] - 4, self.box[3] + 26, unit_x)
            text(self.box[0] - 30, self.box[1] - 30, unit_y)

        def line(self, course: list, colour: tuple[int, int, int], width: int = 2) -> None:
            points = [
                self.at(min(max(x, self.xs[0]), self.xs[-1]), min(max(y, self.ys[0]), self.ys[-1]))
                for x, y in course
            ]
            draw.line(points, colour, width * big, joint="curve")

    left = Axes((60, 70, 500, 510), (-0.5, 0, 0.5, 1, 1.5), (-0.5, 0, 0.5, 1, 1.5))
    left.grid("m", "m")
    left.line(drive.theirs, red)
    left.line([(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)], grey, 8)
    left.line(drive.true, blue, 3)
    left.line(drive.ours, orange)
    text(60, 8, "A square of 1 m", black)
    text(190, 8, "true way", blue)
    text(275, 8, "odometry", orange)
    text(360, 8, "the document's", red)
    right = Axes((620, 70, 1070, 510), (0, 0.2, 0.4, 0.6, 0.8, 1.0), (0, 0.1, 0.2, 0.3, 0.4))
    right.grid("s", "m/s")
    for edge in (STEP * 0.95, STEP * 1.05):
        right.line([(0, edge), (1, edge)], (150, 190, 150))
    for answer, colour in zip(wheels, (blue, orange), strict=True):
        right.line([point for point in answer.course if point[0] <= 1.0], colour, 3)
    text(620, 8, f"A step to {STEP} m/s, and ±5 %", black)
    text(840, 8, "right wheel", blue)
    text(940, 8, "left wheel", orange)
    PLOT.parent.mkdir(parents=True, exist_ok=True)
    image.resize((wide, high), Image.Resampling.LANCZOS).save(PLOT)


def main() -> int:
    seeds = range(3) if "--quick" in sys.argv[1:] else range(12)
    rows = []
    for seed in seeds:
        figures, drive, wheels = measure(seed)
        rows.append(figures)
        if seed == 0:
            plot(drive, wheels)
    worst = {
        key: max(float(row[key]) for row in rows)  # type: ignore[arg-type]
        for key in rows[0]
        if key not in ("seed", "gains")
    }
    good = (
        worst["settled_s"] < SETTLED
        and worst["overshoot"] < OVERSHOOT
        and worst["position"] < METRES
        and worst["heading"] < DEGREES
    )
    if "--json" in sys.argv[1:]:
        json.dump({"bodies": rows, "worst": worst, "good": good}, sys.stdout, indent=1)
        print()
        return 0 if good else 1
    print("      step to 0.3 m/s       square of 1 m         uncalibrated          the document's")
    print("seed  settled  overshoot   position   heading   position   heading   position   heading")
    for row in [*rows, {"seed": "all", **worst}]:
        print(
            f"{row['seed']:>4}{row['settled_s']:>7.2f} s{row['overshoot']:>10.1%}"
            f"{row['position']:>12.2%}{row['heading']:>9.1f}°"
            f"{row['uncalibrated_position']:>11.2%}{row['uncalibrated_heading']:>9.1f}°"
            f"{row['document_position']:>11.1%}{row['document_heading']:>9.1f}°"
        )
    print(
        f"asked for: settled within {SETTLED} s, overshoot under {OVERSHOOT:.0%}, position within"
        f" {METRES:.0%} of the path, heading within {DEGREES:g}°: {'yes' if good else 'NO'}"
    )
    print(f"the norm of the document's quaternion: {worst['document_quaternion']:.3f}")
    print(f"seed 0: {PLOT.relative_to(ROOT)}")
    return 0 if good else 1


if __name__ == "__main__":
    raise SystemExit(main())
