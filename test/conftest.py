"""What every test process needs before the first import: its own ROS domain, the right package."""

import os
import signal
import sys
from importlib.machinery import PathFinder
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

ROOT = Path(__file__).resolve().parent.parent

# tomotactile_ros as installed, with its messages; from the source tree otherwise
others = [entry for entry in sys.path if Path(entry or ".").resolve() != ROOT]
installed = PathFinder.find_spec("tomotactile_ros", others) is not None
sys.path[:] = others if installed else [str(ROOT), *others]

# ROS traffic stays on this machine (Humble knows only the older variable)
if os.environ.get("ROS_DISTRO") == "humble":
    os.environ.setdefault("ROS_LOCALHOST_ONLY", "1")
else:
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
os.environ.setdefault("OMP_NUM_THREADS", "1")
# programs that tests start find the same package, wherever they run
os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, sys.path))
# killed processes leave shared memory behind that can make later ones in their domain deaf
os.environ.setdefault("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
# a shell ignores it for what runs in its background, and all children would
signal.signal(signal.SIGINT, signal.default_int_handler)
# who ends the tests ends their programs: left behind, they would publish in the domain of a later test
signal.signal(signal.SIGTERM, signal.default_int_handler)
os.environ.setdefault("ROS_PYTHON_CHECK_FIELDS", "1")  # messages complain of what does not fit
# an example may take as long as it takes: a busy machine is no defect. A quarter of the usual number of
# them, as every run draws others
settings.register_profile(
    "slow", deadline=None, max_examples=25, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("slow")


LONGEST = """
    learning_live nodes_chain nodes_parameters estimation_shape estimation_search estimation_rim
    nodes_time examples learning nodes_live nodes_optimizer reconstruction_pipeline
    reconstruction_faults view_page nodes_serial nodes_kept bench_trade reconstruction_discs
    nodes_touches nodes_refusal nodes_skin estimation_rows nodes_replay optimizer_command optimizer_work
    optimizer_touch optimizer_equalize optimizer_free devices_serial devices_doubts security_policy
    estimation_motion
"""


def pytest_configure(config):
    """Files go to test processes in the order in which they are collected."""
    if hasattr(config.option, "loadscopereorder"):
        config.option.loadscopereorder = False


def pytest_collection_modifyitems(items):
    """Files that take longest come first: the last ones are short, and no process is left alone with much."""
    place = {f"test_{name}": number for number, name in enumerate(LONGEST.split())}
    items.sort(key=lambda item: place.get(item.path.stem, len(place)))


@pytest.fixture(scope="session", autouse=True)
def own_ros_domain():
    """Give this test process a ROS domain that no other test process on the machine uses."""
    try:
        from domain_coordinator import domain_id
    except ImportError:
        yield
        return
    with domain_id() as number:
        os.environ["ROS_DOMAIN_ID"] = str(number)
        yield


@pytest.fixture(scope="session", autouse=True)
def sheets_are_made_once():
    """See solved_once, which imports what must not be imported earlier."""
    from solved_once import solved_once

    with solved_once():
        yield


@pytest.fixture(autouse=True)
def signals_as_before():
    """Programs whose `main` a test calls here set handlers; what is ignored is inherited."""
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGALRM)
    before = {number: signal.getsignal(number) for number in numbers}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture
def domain():
    """A ROS domain for one test."""
    from domain_coordinator import domain_id

    with domain_id() as number:
        yield number


@pytest.fixture
def probe(domain):
    """A node of the test's own in the test's domain."""
    from ros_support import Probe

    probe = Probe(domain)
    yield probe
    probe.close()


@pytest.fixture
def spawn(domain):
    """Starts commands in the test's domain, `warm` or not, and ends what is left of them."""
    from ros_support import Process

    processes = []

    def spawn_one(*words, warm=True):
        processes.append(Process([*map(str, words)], domain, warm))
        return processes[-1]

    yield spawn_one
    for process in processes:
        process.kill()
        print(process.output)  # shown where the test has failed


@pytest.fixture
def start(spawn, tmp_path, monkeypatch):
    """Starts programs of this package, `warm` or as they are installed."""
    from ros_support import program, ros_arguments

    monkeypatch.setenv("ROS_HOME", str(tmp_path / "ros"))  # what nodes keep there is of one test

    def start_one(name, parameters=None, warm=True, **names):
        return spawn(program(name), *ros_arguments(parameters or {}, **names), warm=warm)

    return start_one


@pytest.fixture
def scene(tmp_path):
    """File of a scene with one contact, see ros_checks.PRESSED."""
    from ros_checks import write_scene

    return write_scene(tmp_path)


@pytest.fixture
def mistake(capsys, tmp_path, monkeypatch):
    """What a command says in its only line; it ends with 2 and has written nothing."""
    from tomotactile_ros.cli import main

    monkeypatch.chdir(tmp_path)

    def say(words, main=main):
        before = sorted(tmp_path.iterdir())
        try:
            status = main(words.split() if isinstance(words, str) else [*map(str, words)])
        except SystemExit as end:
            status = end.code
        said = capsys.readouterr()
        (line,) = said.err.strip().splitlines()
        assert status == 2 and not said.out and sorted(tmp_path.iterdir()) == before
        return line

    return say


@pytest.fixture
def reference_model():
    """Skips where there is no reference model."""
    pytest.importorskip("skfem")
    try:
        import gmsh  # noqa: F401
    except (ImportError, OSError) as error:
        pytest.skip(f"no Gmsh: {error}")
