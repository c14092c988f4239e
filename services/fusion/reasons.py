"""What does it mean that something could not be used, and what can an operator do about it?

Everything fusion, its chunker, its tracker and its inbox leave out is counted under a reason. A few of a kind are
everyday life; when there are many within a minute the health page shows the reason with these words.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["EXPLANATIONS", "Explanation", "coarse", "explain"]


@dataclass(frozen=True)
class Explanation:
    """When a counted reason is worth telling, and how.

    Attributes:
        least: how many within a minute are worth telling.
        means: what it means, after "N × reason:".
        do: what to do.
    """

    least: int
    means: str
    do: str


_PHONE_CLOCK = "compare the gateway's clock with the cameras'; NTP on every machine keeps them together"

EXPLANATIONS: dict[str, Explanation] = {
    "detection off the floor or without an extent": Explanation(
        60,
        "cameras see people outside the floor plan, or a detector reports covariances that are lines or nonsense",
        "check the camera's calibration and the floor's outline (the dashboard's page Cameras), or leave mirrors, "
        "screens and the street out of its area_of_interest; with a detector of your own, check its covariances",
    ),
    "frame of an unknown camera or floor": Explanation(
        1,
        "a camera reports for a floor that is not this area's",
        "camera and fusion must read the same site file: restart the one whose file is older",
    ),
    "camera of another area": Explanation(
        1, "a camera of another area reports here", "restart camera and fusion with the same site file"
    ),
    "radio without a known access point": Explanation(
        30,
        "phones hear access points that the site file does not name",
        "add the addresses of this floor's access points to the site file; until then these phones get no name",
    ),
    "radio told again or out of order": Explanation(
        30,
        "a phone's scans come twice or in the wrong order",
        "two gateways may publish the same phone, or one phone's token is used by two phones",
    ),
    "phone in two places at once": Explanation(
        6,
        "what a device hears belongs to two places that take turns",
        "two phones use one token (a copied app or backup): the log names the device; withdraw it and enrol both anew",
    ),
    "time went backwards": Explanation(
        1,
        "a camera's frames are older than the ones before",
        "its clock jumps: set NTP on the camera; a recorded video that starts over is taken for a new pass by itself",
    ),
    "frame from the far future": Explanation(
        3,
        "a camera's clock is ahead of the other cameras'",
        "set NTP on the camera or correct its latency in the site file",
    ),
    "frame too late": Explanation(
        15,
        "a camera's frames come after everybody else's time is over",
        "its clock or its network lags: set NTP, correct its latency in the site file, or raise camera_lateness",
    ),
    "frame of the old time": Explanation(
        1, "the cameras' clock was set; what waited from before was left out", "nothing, if it was meant"
    ),
    "frame twice": Explanation(15, "a camera's frames arrive twice", "only one camera service may run for each camera"),
    "frame without a time": Explanation(1, "frames carry no usable time", "restart the camera service"),
    "radio without a time": Explanation(1, "radio carries no usable time", "restart the gateway"),
    "motion without a time": Explanation(1, "steps carry no usable time", "restart the gateway"),
    "radio too old": Explanation(30, "radio arrives too late to be live", _PHONE_CLOCK),
    "motion told again or out of order": Explanation(
        30,
        "a phone's steps come twice or in the wrong order",
        "two gateways may publish the same phone, or one phone's token is used by two phones",
    ),
    "motion too old": Explanation(30, "steps arrive too late to be live", _PHONE_CLOCK),
    "radio from the far future": Explanation(30, "radio is ahead of the cameras' time", _PHONE_CLOCK),
    "motion from the far future": Explanation(30, "steps are ahead of the cameras' time", _PHONE_CLOCK),
    "radio of another time": Explanation(30, "radio is marked late, or its time is not the cameras'", _PHONE_CLOCK),
    "motion of another time": Explanation(30, "steps are marked late, or their time is not the cameras'", _PHONE_CLOCK),
    "phone whose place was no number": Explanation(
        1,
        "what a phone told made its place overflow, and it was placed anew",
        "see what the gateway publishes of steps and radio: a length, a variance or a level must be absurd",
    ),
    "radio waiting for cameras": Explanation(1, "phones report and no camera does", "start the cameras"),
    "motion waiting for cameras": Explanation(1, "phones report and no camera does", "start the cameras"),
    "phone's data marked late": Explanation(
        300,
        "phones send what they measured long ago",
        "they come out of a dead spot: see to the wireless network there; live positions do not use it",
    ),
    "radio model that does not fit the site": Explanation(
        1,
        "a learned radio model is of another site or other access points, or holds impossible values, and is not used",
        "the log says what is wrong with it; learning and fusion must read the same site file, and a model is for the "
        "museum it was exported from",
    ),
    "radio model older than the one in use": Explanation(
        1,
        "learning offers a radio model with a number that is passed already",
        "learning's store was lost or is an old copy: remove fusion's state folder once, or let learning activate anew",
    ),
    "radio model for a tracker that takes none": Explanation(
        1,
        "a radio model was learned and the tracker in use cannot change its own",
        "choose another tracker, or give the model by --radio-model at the next start",
    ),
    "overtaken": Explanation(
        30,
        "frames came faster than they could be tracked and the newest was taken",
        "this machine is too busy: fewer areas or a lower frame rate on it",
    ),
    "queue full": Explanation(
        1, "messages waited so long that some were thrown away", "this machine is too busy: give fusion more of it"
    ),
    "gap": Explanation(
        30,
        "numbered messages never arrived",
        "the router was away, or the network or the machine is too busy",
    ),
    "not understood": Explanation(
        1, "messages are not what they should be", "run the same version of Atrium everywhere"
    ),
}
"""By reason as it is counted."""

_OTHER = Explanation(30, "fusion could not use it", "see the service's log and metrics")


def explain(reason: str, count: int) -> str | None:
    """Return in plain words what ``count`` of a reason within a minute mean; None where so few mean nothing."""
    known = EXPLANATIONS.get(reason, _OTHER)
    if count < known.least:
        return None
    return f"{coarse(count)} or more x {reason} in the last minute: {known.means}; {known.do}"


def coarse(number: float) -> int:
    """Return the largest of 1, 2, 5, 10, 20, 50 … that is not above ``number``, at least 1.

    Words that change with every look are read by nobody and fill the log.
    """
    scale = 1
    while scale * 10 <= number:
        scale *= 10
    return next((scale * step for step in (5, 2) if scale * step <= number), scale)
