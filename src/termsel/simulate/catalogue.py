"""Settings of simulated scenes: sensors, places and numbers of features."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Scene:
    """Settings of a simulated scene; name and summary are those of its `DatasetSpec`."""

    name: str
    summary: str
    number: int  # seed of the terrain, and first part of the seed of all that is drawn
    lon: float  # centre of the image [deg]
    lat: float
    heights: tuple[float, float]  # lowest and highest in the image, ellipsoidal [m]
    image_size: tuple[int, int]  # lines and samples [px]
    gsd: float  # ground sample distance [m]
    altitude: float  # of the orbit [m]
    inclination: float  # see `pushbroom_at` for the angles [deg]
    off_nadir: float
    look_azimuth: float
    # Change of roll, pitch and yaw from the middle to the end of the scene by each power of time
    # from the first, as movement in the image [px]; for yaw, that of the array's ends.
    drift: tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]
    jitter: tuple[float, float]  # amplitudes of roll and pitch [px]
    relief: float  # rms of what no low polynomial fits [m]
    roles: tuple[int, int, int]  # numbers of control, selection and independent check points
    lines: int = 0
    wrong_lines: int = 0  # mismatched ones among them
    noise: float = 0.5  # standard deviation of line and sample [px]


SCENES: dict[str, Scene] = {scene.name: scene for scene in (
    Scene("ikonos-hamedan",
          "simulated IKONOS scene of Hamedan, 1 m: 74 points, 120 lines, 8 of them blunders (after "
          "Valadan Zoej et al. 2002, Akhoundi Khezrabad et al. 2020)",
          number=1, lon=48.5, lat=34.8, heights=(1700.0, 1990.0), image_size=(7000, 8000), gsd=1.0,
          altitude=681e3, inclination=98.1, off_nadir=20.4, look_azimuth=65.0,
          drift=((1.0, 1.2, 0.2), (1.0, 1.5, 0.2), (0.5, 0.5)), jitter=(0.12, 0.15),
          relief=5.5, roles=(24, 24, 26), lines=120, wrong_lines=8),
    Scene("spot-isfahan",
          "simulated SPOT scene of Isfahan, 10 m: 35 points "
          "(after Zakaryaie Nejad et al. 2015)",
          number=2, lon=51.7, lat=32.6, heights=(528.0, 1147.0), image_size=(6000, 6000), gsd=10.0,
          altitude=822e3, inclination=98.7, off_nadir=20.8, look_azimuth=90.0,
          drift=((1.0, 0.8, 0.2), (1.0, 0.8, 0.2), (0.5, 0.5)), jitter=(0.15, 0.15),
          relief=70.0, roles=(12, 11, 12)),
    Scene("irs1c-mashad",
          "simulated IRS-1C scene of Mashad, 5.8 m: 62 points "
          "(after Valadan Zoej et al. 2002)",
          number=3, lon=59.6, lat=36.3, heights=(900.0, 1300.0), image_size=(4000, 4000), gsd=5.8,
          altitude=817e3, inclination=98.7, off_nadir=15.0, look_azimuth=90.0,
          drift=((1.0, 1.5, 0.2), (1.0, 1.5, 0.2), (0.5, 0.5)), jitter=(0.12, 0.15),
          relief=46.0, roles=(20, 20, 22)),
)}

OTHERS: dict[str, Scene] = {scene.name: scene for scene in (
    Scene("geoeye-tehran",
          "simulated GeoEye-1 scene, 0.5 m: 74 points, 120 lines, 8 of them blunders (sensor of "
          "Yavari et al. 2018; the place is termsel's own)",
          number=4, lon=51.4, lat=35.7, heights=(1150.0, 1420.0), image_size=(12000, 12000),
          gsd=0.5, altitude=681e3, inclination=98.1, off_nadir=14.0, look_azimuth=110.0,
          drift=((1.0, 1.2, 0.2), (1.0, 1.5, 0.2), (0.5, 0.5)), jitter=(0.12, 0.15),
          relief=4.0, roles=(24, 24, 26), lines=120, wrong_lines=8),
    Scene("cartosat-hyderabad",
          "simulated Cartosat-1 scene, 2.5 m: 200 points (sensor of Konugurthi et al. 2016; the "
          "place is termsel's own)",
          number=5, lon=78.5, lat=17.4, heights=(460.0, 640.0), image_size=(12000, 12000),
          gsd=2.5, altitude=618e3, inclination=97.9, off_nadir=5.0, look_azimuth=0.0,
          drift=((1.0, 1.2, 0.2), (1.0, 1.5, 0.2), (0.5, 0.5)), jitter=(0.12, 0.15),
          relief=12.0, roles=(100, 0, 100)),
)}
"""Scenes of further sensors of the papers, which are no data sets of their own."""
