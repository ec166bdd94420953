"""From voltage frames to pressure images and contacts."""

from tomotactile_ros.reconstruction.pipeline import Pipeline
from tomotactile_ros.reconstruction.settings import ContactEstimate, Result, Settings

__all__ = ["ContactEstimate", "Pipeline", "Result", "Settings"]
