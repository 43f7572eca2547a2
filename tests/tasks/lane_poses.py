"""Places on the lanes of a road, by the road's reference line alone."""

import numpy as np


def lane_pose(road, lane, s, offset=0.0):
    """The pose in the direction of a lane, `s` m along the reference line and `offset` m to the left of the lane's middle.

    The curvature is that of the middle of the lane.
    """
    middle, way = road.lane_offset(lane), -1.0 if lane > 0 else 1.0
    pose = road.pose(s, middle + way * np.asarray(offset))
    curvature = way * pose.curvature / (1.0 - pose.curvature * middle)
    return pose._replace(heading=pose.heading + (np.pi if lane > 0 else 0.0), curvature=curvature)
