"""Other packages on the sets, as their documentation has them used, where they are installed.

All take points alone, control and selection points alike; Orthority needs the RPC, too, and OpenCV
the focal length.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import numpy as np

from termsel import FeatureSet, TermselError
from termsel.toolkit import FloatArray, require_import

Projection = Callable[[FloatArray], FloatArray]

_ALPHAS = np.logspace(-8, 2, 11)
_RANSAC_PIXELS = 5.0


def gdal_polynomial(features: FeatureSet, seed: int) -> Projection:  # noqa: ARG001
    """Return GDAL's polynomial of the plane; GDAL takes the order that the points allow."""
    return _fit_gdal(features, spline=False)


def gdal_spline(features: FeatureSet, seed: int) -> Projection:  # noqa: ARG001
    """Return GDAL's thin-plate spline, which is exact at the points."""
    return _fit_gdal(features, spline=True)


def _fit_gdal(features: FeatureSet, *, spline: bool) -> Projection:
    """Return the projection of GDAL's transformation by GCPs, a spline or else a polynomial.

    Raises TermselError if rasterio is not installed. GDAL fits when it projects, so that the
    projection raises it if the points do not determine the transformation.
    """
    with require_import("GDAL requires", "rasterio", "rasterio"):
        from rasterio.control import GroundControlPoint
        from rasterio.errors import TransformError
        from rasterio.transform import GCPTransformer
    # GDAL counts rows and columns from the corner of the first pixel, termsel from its centre.
    gcps = [GroundControlPoint(row=line + 0.5, col=sample + 0.5, x=x, y=y)
            for (line, sample), (x, y) in zip(features.points.image.tolist(),
                                              features.points.ground[:, :2].tolist(),
                                              strict=True)]

    def project(ground: FloatArray) -> FloatArray:
        """Return line and sample (n, 2) of ground positions (n, 3), of which the height is ignored.

        Raises TermselError if GDAL fits nothing to the points.
        """
        with ExitStack() as stack:
            try:
                transformer = stack.enter_context(GCPTransformer(gcps, tps=spline))
            except (TransformError, ValueError) as error:
                raise TermselError(f"GDAL fits nothing: {error}") from error
            # Without an op, rasterio rounds to whole pixels; 0.5 px leads back to the centre.
            return np.column_stack(transformer.rowcol(
                ground[:, 0], ground[:, 1], op=lambda value: value)) - 0.5

    return project


def fit_orthority(features: FeatureSet, seed: int) -> Projection:  # noqa: ARG001
    """Return the projection of a vendor's RPC with Orthority's refinement.

    The refinement is a shift and a drift; with one or two points it is a shift alone. Raises
    TermselError if the set has no RPC, or if Orthority is not installed.
    """
    rpc = features.rpc
    if rpc is None:
        raise TermselError("Orthority refines an RPC, and the set has none")
    with require_import("Orthority requires", "orthority", "orthority"):
        from orthority.camera import RpcCamera
        from orthority.fit import refine_rpc
    (line_off, sample_off) = rpc.image_offset
    (line_scale, sample_scale) = rpc.image_scale
    camera_rpc = {
        "line_off": line_off, "samp_off": sample_off, "line_scale": line_scale,
        "samp_scale": sample_scale, "height_off": rpc.ground_offset[2],
        "height_scale": rpc.ground_scale[2], "lat_off": rpc.ground_offset[1],
        "lat_scale": rpc.ground_scale[1], "long_off": rpc.ground_offset[0],
        "long_scale": rpc.ground_scale[0], "line_num_coeff": list(rpc.line_numerator),
        "line_den_coeff": list(rpc.line_denominator),
        "samp_num_coeff": list(rpc.sample_numerator),
        "samp_den_coeff": list(rpc.sample_denominator), "err_bias": None, "err_rand": None}
    gcps = [{"ji": (sample, line), "xyz": tuple(ground)} for (line, sample), ground in zip(
        features.points.image.tolist(), features.points.ground.tolist(), strict=True)]
    # Orthority's documentation asks for more points than the drift has terms, which are two.
    refined = refine_rpc(camera_rpc, gcps, "shift-drift" if len(gcps) > 2 else "shift")
    # A camera must have a size, which an RPC does not use; Orthority has samples before lines.
    lines, samples = features.image_size or (1, 1)
    camera = RpcCamera((samples, lines), refined)
    return lambda ground: np.asarray(camera.world_to_pixel(ground.T))[::-1].T


def fit_opencv_pose(features: FeatureSet, seed: int) -> Projection:  # noqa: ARG001
    """Return the projection of OpenCV's pose of a camera: SQPNP, then least squares.

    The focal length is that of the column `camera_focal`; the principal point is the middle of the
    image. Raises TermselError if the set states no focal length or size of the image, for fewer
    than four points, if OpenCV finds no pose, or if it or pyproj is not installed.
    """
    stated = features.points.attributes.get("camera_focal")
    if stated is None or features.image_size is None:
        raise TermselError("OpenCV's pose requires a focal length, and the set states none")
    with require_import("the peer requires", "opencv-python-headless", "cv2"):
        import cv2
    with require_import("the peer requires", "pyproj", "pyproj"):
        from pyproj import Transformer
    if len(features.points) < 4:
        raise TermselError("OpenCV's pose requires 4 points")
    # Collinearity holds in Cartesian axes. Earth-fixed ones have numbers of 6e6 m; counted from
    # the middle of the points, they keep their digits.
    geocentric = Transformer.from_crs(features.crs, "EPSG:4978", always_xy=True)
    origin = np.column_stack(geocentric.transform(*features.points.ground.T)).mean(axis=0)

    def to_cartesian(ground: FloatArray) -> FloatArray:
        return np.asarray(np.column_stack(geocentric.transform(*ground.T)) - origin)

    lines, samples = features.image_size
    focal = float(stated[0])
    camera = np.array([[focal, 0, (samples - 1) / 2], [0, focal, (lines - 1) / 2], [0, 0, 1]])
    control = to_cartesian(features.points.ground)
    # OpenCV has samples before lines.
    image = np.ascontiguousarray(features.points.image[:, ::-1])
    try:
        _, turn, shift = cv2.solvePnP(control, image, camera, None, flags=cv2.SOLVEPNP_SQPNP)
        turn, shift = cv2.solvePnPRefineLM(control, image, camera, None, turn, shift)
    except cv2.error as error:
        raise TermselError(f"OpenCV fits nothing: {error}") from error
    return lambda ground: np.asarray(cv2.projectPoints(
        to_cartesian(ground), turn, shift, camera, None)[0][:, 0, ::-1])


def fit_ransac(features: FeatureSet, seed: int) -> Projection:
    """Return the projection of scikit-learn's RANSAC: affine, or quadratic from 20 points on.

    Raises TermselError unless there are more points than the polynomial has terms, if no trial
    finds inliers, or if scikit-learn is not installed.
    """
    with _require_sklearn():
        from sklearn.linear_model import LinearRegression, RANSACRegressor
        from sklearn.pipeline import make_pipeline
        from sklearn.preprocessing import PolynomialFeatures, StandardScaler
    positions = _ground_of(features)
    # A trial takes as many points as there are terms, ten for a quadratic model in space; as many
    # again are left to vote on it.
    degree = 1 if len(features.points) < 20 else 2
    terms = PolynomialFeatures(degree)
    n_terms = terms.fit_transform(positions[:1]).shape[1]
    _require(len(positions) > n_terms, "RANSAC", len(positions))
    model = make_pipeline(StandardScaler(), terms, RANSACRegressor(
        LinearRegression(fit_intercept=False), min_samples=n_terms, max_trials=500,
        # scikit-learn compares the sum of the absolute errors of line and sample.
        residual_threshold=2 * _RANSAC_PIXELS, random_state=seed))
    return _fit_peer(model, features, positions)


def fit_ridge(features: FeatureSet, seed: int) -> Projection:
    """Return the projection of scikit-learn's ridge polynomial, as its user would fit it.

    Five folds, drawn with the seed, choose the degree from 1 to 3 and the penalty from `_ALPHAS`.

    Raises
    ------
    TermselError
        If scikit-learn is not installed, or for fewer than 5 points.
    """
    with _require_sklearn():
        from sklearn.linear_model import Ridge
        from sklearn.model_selection import GridSearchCV, KFold
        from sklearn.pipeline import make_pipeline
        from sklearn.preprocessing import PolynomialFeatures, StandardScaler
    positions = _ground_of(features)
    # Each of five folds needs a point.
    _require(len(positions) >= 5, "scikit-learn", len(positions))
    # Positions are scaled first, as the penalty is the same for all coefficients. The grid of
    # degrees and penalties is termsel's own choice.
    model = GridSearchCV(
        make_pipeline(StandardScaler(), PolynomialFeatures(include_bias=False), Ridge()),
        {"polynomialfeatures__degree": [1, 2, 3], "ridge__alpha": _ALPHAS},
        scoring="neg_mean_squared_error", cv=KFold(5, shuffle=True, random_state=seed))
    return _fit_peer(model, features, positions)


def _require_sklearn() -> Any:
    """Return scikit-learn; raises TermselError where it is not installed."""
    return require_import("the peer requires", "scikit-learn", "scikit-learn")


def _fit_peer(model: Any, features: FeatureSet, positions: FloatArray) -> Projection:
    """Return the projection of an estimator of scikit-learn, fitted to positions (n, 2 or 3).

    Raises TermselError if scikit-learn cannot fit it.
    """
    try:
        model.fit(positions, features.points.image)
    except ValueError as error:
        raise TermselError(f"scikit-learn fits nothing: {error}") from error
    width = positions.shape[1]
    return lambda ground: np.asarray(model.predict(ground[:, :width]))


def _ground_of(features: FeatureSet) -> FloatArray:
    """Return ground coordinates (n, 3) of points; (n, 2) if any height is unknown."""
    ground = features.points.ground
    # Without heights the plane is all there is.
    return ground[:, :2] if np.isnan(ground).any() else ground


def _require(is_enough: bool, method_name: str, count: int) -> None:
    """Raise TermselError with the name of a method unless it has enough points."""
    if not is_enough:
        raise TermselError(f"{method_name} requires more than {count} points")
