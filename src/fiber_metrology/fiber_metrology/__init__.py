# SPDX-License-Identifier: Apache-2.0
"""Camera metrology: which spot is of which robot, and where every robot really is.

`measure` takes the spots of some exposures and returns a measured place, joint angles with their
intervals and a verdict for every robot. `fiber_metrology.camera` simulates a camera.
"""

from fiber_metrology.angles import angles_of_places
from fiber_metrology.calibration import NUMBERS, Calibration, GearVerdict, calibrate
from fiber_metrology.calibration_points import calibration_points
from fiber_metrology.centroids import CentroidConfig, find_spots
from fiber_metrology.code_words import CodeWords, code_words
from fiber_metrology.correction import correction_problem, follows
from fiber_metrology.errors import ImageError, MetrologyError
from fiber_metrology.exposures import Lights, combine
from fiber_metrology.identify import Identified, IdentifyConfig, identify
from fiber_metrology.knowledge import DriveErrors, Knowledge
from fiber_metrology.measure import Expected, MeasureConfig, Measurement, Verdict, measure
from fiber_metrology.plate import Plate, PlateConfig, solve_plate
from fiber_metrology.polynomials import PolynomialMap, fit_map
from fiber_metrology.recovery import Recovered, RecoveryConfig, recover, turn_within_margin
from fiber_metrology.spots import Spots, checked_spots
from fiber_metrology.trends import Trend, trend_of
from fiber_metrology.wiring import WiringConfig, tell_wiring
from fiber_metrology.wiring_answer import Wiring, WiringVerdict

__all__ = [
    "NUMBERS",
    "Calibration",
    "CentroidConfig",
    "CodeWords",
    "DriveErrors",
    "Expected",
    "GearVerdict",
    "Identified",
    "IdentifyConfig",
    "ImageError",
    "Knowledge",
    "Lights",
    "MeasureConfig",
    "Measurement",
    "MetrologyError",
    "Plate",
    "PlateConfig",
    "PolynomialMap",
    "Recovered",
    "RecoveryConfig",
    "Spots",
    "Trend",
    "Verdict",
    "Wiring",
    "WiringConfig",
    "WiringVerdict",
    "angles_of_places",
    "calibrate",
    "calibration_points",
    "checked_spots",
    "code_words",
    "combine",
    "correction_problem",
    "find_spots",
    "fit_map",
    "follows",
    "identify",
    "measure",
    "recover",
    "solve_plate",
    "tell_wiring",
    "trend_of",
    "turn_within_margin",
]
