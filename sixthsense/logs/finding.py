"""What is found out about a log: one kind for each thing that may be odd, and what is done about it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple


class Kind(NamedTuple):
    """What is known of all findings of a kind."""

    action: Literal["applied", "said", "refused"]
    """applied: the value is set in the configuration; said: a note; refused: an error"""
    text: str
    """of a note, or what was found; with the fields of the finding"""
    option: str = ""
    """that sets it, or that makes the log readable"""


KINDS = {
    # of both scans and odometry
    "clocks": Kind("applied", "turns show {value:.2f} s later in the scans than in the odometry", "time_offset"),
    "field_of_view": Kind("applied", "the turns fit a field of view of {degrees:.1f}°", "laser.fov"),
    "frozen_odometry": Kind("applied", "the odometry never changes, but the scans do", "no_odometry"),
    "turned_around": Kind("said", "scans turn against the odometry: is one of both inverted?", "laser.mirrored"),
    "turns_scaled": Kind("said", "scans turn {value:.2f} times as much as odometry: is the angle between beams wrong?"),
    # of odometry
    "jump": Kind("said", "odometry jumps {place}, at most by {value:.1f} m: it goes on from where it was"),
    "gap": Kind("said", "no odometry by its stamps {place}: {value:.0f} scans are predicted by the last velocity"),
    "odometry_unit": Kind("refused", "positions of odometry that change by {value:.4g} a second, which are mm or cm"),
    "headings_unit": Kind("refused", "headings of odometry, along which the robot goes only if they are degrees"),
    "axes_exchanged": Kind("refused", "odometry, along whose headings the robot goes only with x and y exchanged"),
    # of the laser
    "ranges_unit": Kind("refused", "ranges with a median of {value:.5g}, which are mm or cm"),
    "no_return": Kind("refused", "no return in {value:.0f} scans: are their ranges in mm?"),
    "sweep": Kind("said", "time_increment makes a sweep of {value:.3g} s, {place}: is its unit wrong?"),
    "angle_increment": Kind("said", "angle_increment spans {value:.4g} of what angle_min and angle_max do: it is used"),
    "assumed_beams": Kind("said", "assumed: beams {place}, which a FLASER line does not say", "laser.fov"),
    "assumed_mount": Kind("said", "assumed: the laser at {place}", "laser.mount"),
    "assumed_range": Kind("said", "assumed: a laser of {value:.2f} m, {place}", "laser.max_range"),
    # of stamps
    "stamps": Kind("said", "stamps decrease or repeat at {value:.0f} scans: replayed in the order of the file"),
    "stamps_unit": Kind("said", "the robot drives at {value:.2g} m/s by its stamps: are these milliseconds?"),
    "stamps_of_recording": Kind("said", "stamps of headers decrease, repeat or are 0: those of recording are used"),
    # of the file
    "left_out": Kind("said", "{value:.0f} {place}"),
    "cut_short": Kind("said", "{place}"),
    "odometry_frames": Kind("said", "odometry: /tf {place}", "odometry_frames"),
    # of a trajectory beside the wheels
    "mount": Kind("said", "by wheels and scans the laser is {place}", "laser.mount"),
    "odometry_scale": Kind("said", "true distances are {value:.2f} times those of the wheels"),
    "wheels_reversed": Kind("said", "the wheels drive the other way than the scans: do they report the wrong sign?"),
}
"""all kinds; a page of the documentation is made of them"""


@dataclass(frozen=True, slots=True)
class Finding:
    """Something that is odd in a log."""

    kind: str
    """a key of `KINDS`"""
    value: float = math.nan
    """seconds, metres, radians, a count or a ratio, as the kind says; NaN without one"""
    sigma: float = math.nan
    """of the value; NaN where it is not measured"""
    place: str = ""
    """where it is, or what it is of"""
    vector: tuple[float, ...] = ()
    """of a finding that has more numbers: x, y and heading of a mount"""

    @property
    def action(self) -> str:
        """What is done about it."""
        return KINDS[self.kind].action

    @property
    def text(self) -> str:
        """What was found, without the option."""
        return KINDS[self.kind].text.format(value=self.value, place=self.place, degrees=math.degrees(self.value))

    def __str__(self) -> str:
        if not (option := KINDS[self.kind].option):
            return self.text
        numbers = self.vector or (self.value,) * (self.action == "applied" and not math.isnan(self.value))
        setting = " ".join([f"`{option}`", *(f"{number:.4g}" for number in numbers)])
        given = "otherwise" if self.kind == "odometry_frames" or self.kind.startswith("assumed") else "if so"
        return f"{self.text} ({f'{given} set ' * (self.action != 'applied')}{setting})"
