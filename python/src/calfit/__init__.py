"""Reads the parameter files of calfit and applies them to the readings of a magnetometer.

    import calfit
    p = calfit.read("THERMAL_PARAMETER__13-04-03-09-22-38.TPF", "THERMAL_OFF_PARAMETER__13-04-03-09-53-35.TOF")
    b, u, flags = p.apply(x, y, z, t_degc)

Readings are enT along the sensor axes, fields nT, temperatures degC, angles degrees. What the package does not know it refuses.
"""

from .errors import Refused
from .parameters import FIELD, NO_READING, NO_TEMPERATURE, TEMPERATURE, Parameters, read
from .quantities import Covariance

__all__ = ["FIELD", "NO_READING", "NO_TEMPERATURE", "TEMPERATURE", "Covariance", "Parameters", "Refused", "read"]
__version__ = "0.1.0"
