"""What stands and drives on roads as MuJoCo's XML: traffic lights, the lines before them, and cars."""

import numpy as np

from deadreckon.tasks.road_network import Network, Signal
from deadreckon.tasks.roads import Road
from deadreckon.tasks.traffic import LENGTH, WIDTH

LAMPS = ((0.10, 0.90, 0.30), (1.00, 0.80, 0.10), (0.95, 0.10, 0.10))  # green, yellow, red
DARK = 0.15  # of a lamp's brightness, where another is lit
LAMP, HIGH = 0.22, 3.0  # m, radius of lamps, which are flat, so that others than those meant see little; height of the lowest
LINE = 0.4  # m, width of stop lines
BEYOND = 3.0  # m behind the junction, where lights stand
PAINTS = ("0.75 0.12 0.12", "0.92 0.92 0.92", "0.12 0.25 0.60", "0.60 0.62 0.65", "0.85 0.65 0.10", "0.10 0.40 0.25")
GHOST = 'contype="0" conaffinity="0"'  # nothing touches


def lamp_names(signal: int) -> list[str]:
    """Names of the lamps of a light, green, yellow and red."""
    return [f"lamp_{signal}_{colour}" for colour in range(len(LAMPS))]


def shades(shown: int) -> np.ndarray:
    """(3, 4) colours of the lamps of a light that shows green (0), yellow (1) or red (2)."""
    bright = np.where(np.arange(len(LAMPS)) == shown, 1.0, DARK)
    return np.concatenate([np.array(LAMPS) * bright[:, None], np.ones((len(LAMPS), 1))], 1)


def lights(network: Network) -> str:
    """Poles with three lamps, behind the junction where those before it see them, on their right."""
    found = []
    for signal in network.signals:
        x, y, heading = _place(network, signal)
        facing = f'pos="{x:.4f} {y:.4f} 0" euler="0 0 {np.degrees(heading):.4f}"'
        lamps = "\n".join(
            f'      <geom name="{name}" type="cylinder" pos="-0.16 0 {HIGH + 0.55 * i:.2f}" size="{LAMP} 0.02" '
            f'zaxis="1 0 0" rgba="{" ".join(map(str, shade))}" {GHOST}/>'
            for i, (name, shade) in enumerate(zip(lamp_names(signal.id), shades(2)))
        )
        found.append(
            f'    <body name="light_{signal.id}" {facing}>\n'
            f'      <geom type="cylinder" pos="0 0 {HIGH / 2}" size="0.08 {HIGH / 2}" rgba="0.25 0.25 0.25 1" {GHOST}/>\n'
            f'      <geom type="box" pos="0 0 {HIGH + 0.55}" size="0.15 0.32 0.9" rgba="0.08 0.08 0.08 1" {GHOST}/>\n'
            f"{lamps}\n    </body>\n"
        )
    return "".join(found)


def _place(network: Network, signal: Signal) -> tuple[float, float, float]:
    """x and y in m of the pole of a light, and the heading in rad of who drives towards it."""
    road = network.road(signal.road)
    lanes = [(road.id, lane.id) for lane in road.lanes if (lane.id < 0) == (signal.orientation == "+")]
    pose = road.pose(signal.s, signal.t)
    heading = float(pose.heading) + (0.0 if signal.orientation == "+" else np.pi)
    # How far ahead the ways through the junction lead.
    ways = [network.lane_path(way) for lane in lanes for way in network.following.get(lane, ())]
    ends = [way.pose(way.total) for way in ways]
    ahead = max((float((end.x - pose.x) * np.cos(heading) + (end.y - pose.y) * np.sin(heading)) for end in ends), default=0.0)
    far = ahead + BEYOND if ways else 0.0
    return float(pose.x) + far * np.cos(heading), float(pose.y) + far * np.sin(heading), heading


def stop_lines(network: Network, road: Road) -> list[tuple[tuple[float, float], tuple[float, float]]]:
    """Of each line before a light on a road: the left and the right end in m beside the reference line, and its span in m."""
    found = []
    for signal in network.signals:
        if signal.road == road.id:
            along = signal.orientation == "+"
            wide = sum(lane.width for lane in road.lanes if (lane.id < 0) == along)
            found.append((
                (0.0, -wide) if along else (wide, 0.0),
                (signal.s, signal.s + LINE) if along else (signal.s - LINE, signal.s),
            ))  # fmt: skip
    return found


def other_cars(count: int) -> str:
    """Cars that are put where they are wanted: a body, dark windows above it, and dark wheels below."""
    return "".join(
        f'    <body name="other_{i}" mocap="true">\n'
        + "".join(
            f'      <geom type="box" pos="{at} 0 {high}" size="{long} {wide} {tall}" rgba="{paint} 1" {GHOST}/>\n'
            for at, high, long, wide, tall, paint in (
                (0.0, 0.32, 0.42 * LENGTH, 0.47 * WIDTH, 0.28, "0.06 0.06 0.06"),
                (0.0, 0.70, LENGTH / 2, WIDTH / 2, 0.28, PAINTS[i % len(PAINTS)]),
                (-0.3, 1.20, 0.26 * LENGTH, 0.43 * WIDTH, 0.24, "0.15 0.18 0.22"),
                (-0.3, 1.46, 0.24 * LENGTH, 0.42 * WIDTH, 0.03, PAINTS[i % len(PAINTS)]),
                (-LENGTH / 2, 0.75, 0.02, 0.45 * WIDTH, 0.06, "0.65 0.05 0.05"),
                (LENGTH / 2, 0.75, 0.02, 0.45 * WIDTH, 0.06, "0.98 0.98 0.85"),
            )
        )
        + "    </body>\n"
        for i in range(count)
    )
