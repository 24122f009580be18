"""Configuration of stems and of landmark localization."""

from __future__ import annotations

from pydantic import Field

from segloc.proposals.pose import PoseConfig
from segloc.system.section import Section


class StemConfig(Section):
    """Detection and use of stems in clouds."""

    fewest: int = Field(6, ge=3, le=1000, description="fewest stems of a query")
    most: int = Field(
        20_000, ge=3, le=10**6, description="most stems of a map, those with most points first"
    )
    lowest_m: float = Field(
        0.5, ge=-10, le=100, description="lower bound of the height above ground"
    )
    highest_m: float = Field(
        5.0, gt=0, le=100, description="upper bound of the height above ground, metres"
    )
    slice_m: float = Field(0.6, ge=0.05, le=10, description="height of a slice")
    tolerance: float = Field(
        0.3, ge=0.02, le=5, description="largest gap between points of a cluster in a slice, metres"
    )
    widest_m: float = Field(1.2, gt=0, le=20, description="largest width of a stem")
    link_m: float = Field(
        0.3, gt=0, le=5, description="largest offset of a stem from slice to slice"
    )
    fewest_points: int = Field(4, ge=3, le=10_000, description="fewest points of a stem")
    least_length_m: float = Field(0.9, gt=0, le=50, description="shortest visible length of a stem")


class Effort(Section):
    """Effort of one attempt at matching."""

    neighbours: int = Field(
        4, ge=2, le=32, description="neighbours of a landmark that form triangles with it"
    )
    alike: int = Field(1, ge=1, le=100, description="map triangles matched to each triangle")
    most_landmarks: int = Field(
        32, ge=3, le=10_000, description="most landmarks of a query, those nearest to the sensor"
    )
    most_matches: int = Field(400, ge=3, le=30_000, description="most matches, the best first")
    most_candidates: int = Field(6, ge=1, le=1000, description="most poses compared with the map")


class LandmarkConfig(Section):
    """Configuration of landmark maps and localization."""

    merge_radius: float = Field(
        0.5, gt=0, le=10, description="detections closer than this are one landmark, metres"
    )
    min_views: int = Field(2, ge=1, le=1000, description="fewest views of a landmark of a map")
    efforts: tuple[Effort, ...] = Field(
        (
            Effort(),
            Effort(
                neighbours=10, alike=8, most_landmarks=64, most_matches=3000, most_candidates=24
            ),
        ),
        min_length=1,
        description="attempts, until a pose is accepted or ambiguous",
    )
    key_noise_m: float = Field(0.2, gt=0, le=10, description="noise of the sides of a triangle")
    key_noise_height_m: float = Field(0.5, gt=0, le=10, description="noise of height differences")
    key_noise_diameter_m: float = Field(0.1, gt=0, le=10, description="noise of diameters")
    most_key_noise: float = Field(
        4.0,
        gt=0,
        le=100,
        description="largest difference of matching triangles, in units of their noise",
    )
    pose: PoseConfig = PoseConfig(max_candidates=24)
    tolerance: float = Field(
        0.5, gt=0, le=10, description="largest horizontal residual of an inlier, metres"
    )
    height_tolerance: float = Field(
        2.0, gt=0, le=100, description="largest vertical residual of an inlier, metres"
    )
    max_refined: int = Field(4, ge=2, le=100, description="most candidates refined")
    min_confidence: float = Field(
        0.99, ge=0, le=1, description="least probability of an accepted pose"
    )
