# What `import tomotactile_ros as tt` offers: named here and nowhere else. `__init__.py` imports each from
# its module when it is first used; type checkers and editors read this file as it is.

from tomotactile_ros.frame import Frame as Frame
from tomotactile_ros.frames_file import FramesFile as FramesFile
from tomotactile_ros.frames_file import load_frames as load_frames
from tomotactile_ros.importer.frames import Imported as Imported
from tomotactile_ros.importer.frames import import_frames as import_frames
from tomotactile_ros.layouts.layout import Layout as Layout
from tomotactile_ros.layouts.layout import equal_grid as equal_grid
from tomotactile_ros.layouts.layout import load_layout as load_layout
from tomotactile_ros.layouts.outline import Outline as Outline
from tomotactile_ros.learning.file import load_sensor as load_sensor
from tomotactile_ros.learning.recorded import Learned as Learned
from tomotactile_ros.learning.recorded import learn as learn
from tomotactile_ros.learning.state import SensorState as SensorState
from tomotactile_ros.optimizer.request import Request as Request
from tomotactile_ros.optimizer.step import best_of as best_of
from tomotactile_ros.optimizer.work import Work as Work
from tomotactile_ros.reconstruction.calibration import fit_contact_law as fit_contact_law
from tomotactile_ros.reconstruction.calibration import load_calibration as load_calibration
from tomotactile_ros.reconstruction.calibration import measure_conductance as measure_conductance
from tomotactile_ros.reconstruction.calibration import save_calibration as save_calibration
from tomotactile_ros.reconstruction.comparison import greit as greit
from tomotactile_ros.reconstruction.comparison import jac as jac
from tomotactile_ros.reconstruction.pipeline import Pipeline as Pipeline
from tomotactile_ros.reconstruction.settings import ContactEstimate as ContactEstimate
from tomotactile_ros.reconstruction.settings import Result as Result
from tomotactile_ros.reconstruction.settings import Settings as Settings
from tomotactile_ros.scenes.channels import Channels as Channels
from tomotactile_ros.scenes.channels import Rms as Rms
from tomotactile_ros.scenes.contact import Contact as Contact
from tomotactile_ros.scenes.contact_law import ContactLaw as ContactLaw
from tomotactile_ros.scenes.defects import Adc as Adc
from tomotactile_ros.scenes.defects import Defects as Defects
from tomotactile_ros.scenes.defects import Noise as Noise
from tomotactile_ros.scenes.scene import Scene as Scene
from tomotactile_ros.scenes.scene import load_scene as load_scene
from tomotactile_ros.simulation import Simulator as Simulator
from tomotactile_ros.support.errors import Doubt as Doubt
from tomotactile_ros.support.errors import InputError as InputError
from tomotactile_ros.view.figure import plot as plot

__version__: str
