# ruff: noqa: S104, S108 - addresses and folders inside a container
import json
import os
import re
import shlex
import shutil
import socket
import subprocess
import sys
import threading
import tomllib
from dataclasses import dataclass, field
from fnmatch import fnmatch
from pathlib import Path

import pytest
import yaml

from container.scada import load_project
from support.compose import interpolated
from support.foreign import PLANT, Foreign
from support.processes import free_port, program, wait_for

ROOT = Path(__file__).parent.parent
COMPOSE = yaml.safe_load((ROOT / "docker-compose.yml").read_text(encoding="utf-8"))
SERVICES = COMPOSE["services"]


@dataclass
class Stage:
    base: str
    name: str | None
    steps: list[tuple[str, str]] = field(default_factory=list)

    def all(self, instruction):
        return [argument for name, argument in self.steps if name == instruction]

    def last(self, instruction):
        return self.all(instruction)[-1]

    def env(self):
        pairs = [pair for argument in self.all("ENV") for pair in shlex.split(argument)]
        return dict(pair.split("=", 1) for pair in pairs)


def parse(text):
    """The global ARGs and the stages of a Dockerfile; line by line, as the reference tells."""
    lines = "\n".join(line for line in text.splitlines() if not line.lstrip().startswith("#"))
    arguments, stages = {}, []
    for line in filter(str.strip, lines.replace("\\\n", " ").splitlines()):
        instruction, argument = line.strip().split(None, 1)
        if instruction == "FROM":
            words = argument.split()
            stages.append(Stage(words[0], words[2] if len(words) > 1 else None))
        elif stages:
            stages[-1].steps.append((instruction, re.sub(r"\s+", " ", argument)))
        else:
            assert instruction == "ARG"
            name, default = argument.split("=", 1)
            arguments[name] = default
    return arguments, stages


def exec_form(argument):
    words = yaml.safe_load(argument)  # a JSON list is YAML
    assert isinstance(words, list), f"not in exec form: {argument}"
    return words


ARGUMENTS, STAGES = parse((ROOT / "Dockerfile").read_text(encoding="utf-8"))
BUILD, FINAL = STAGES


# -- Dockerfile


def test_the_base_image_is_slim_and_may_be_chosen():
    assert {stage.base for stage in STAGES} == {"${PYTHON_IMAGE}"}
    assert re.fullmatch(r"docker\.io/library/python:3\.\d+-slim(-\w+)?", ARGUMENTS["PYTHON_IMAGE"])


def test_what_runs_carries_neither_builder_nor_installer():
    assert BUILD.name == "build"
    assert FINAL.name is None
    assert not any("pip" in argument for argument in FINAL.all("RUN"))
    assert "--without-pip" in BUILD.all("RUN")[0]


def test_every_dependency_is_installed_by_its_hash_and_without_a_compiler():
    installs = [argument for argument in BUILD.all("RUN") if "pip install" in argument]
    assert "--require-hashes --only-binary=:all: -r requirements-image.lock" in installs[0]
    assert installs[1].startswith('test -z "$FLEET" || python -m pip install')
    assert "--require-hashes --only-binary=:all: -r requirements-fleet.lock" in installs[1]
    assert installs[2:] == ["python -m pip install --no-compile --no-deps ."]


def test_what_is_installed_is_what_is_locked_for_everybody_without_pictures_and_parquet():
    def pinned(name):
        text = (ROOT / name).read_text(encoding="utf-8")
        return set(re.findall(r"^[\w.-]+==\S+", text, re.MULTILINE))

    image, everybody = pinned("requirements-image.lock"), pinned("requirements.lock")
    assert image < everybody
    assert image < pinned("requirements-fleet.lock") < pinned("requirements-dev.lock")
    left_out = {package.partition("==")[0] for package in everybody - image}
    assert {"matplotlib", "pyarrow"} <= left_out
    assert {"numba", "asyncua", "uvicorn"} & left_out == set()


def test_nothing_runs_as_root():
    uid, gid = FINAL.last("USER").split(":")
    assert int(uid) >= 1000
    assert int(gid) >= 1000
    before_user = FINAL.steps[: FINAL.steps.index(("USER", FINAL.last("USER")))]
    assert all(name != "RUN" for name, _ in FINAL.steps[len(before_user) :])


def test_data_are_a_volume_of_the_user():
    assert FINAL.last("VOLUME") == "/data"
    assert f"chown {FINAL.last('USER')} /data" in FINAL.all("RUN")[0]
    assert FINAL.env()["VALVEMAP_DATA"] == "/data"


def test_what_is_written_at_run_time_goes_to_tmp_or_data():
    places = {n: v for n, v in FINAL.env().items() if v.startswith("/") and n != "PATH"}
    assert all(place.startswith(("/tmp", "/data")) for place in places.values()), places


def test_health_is_asked_in_python():
    check = exec_form(FINAL.last("HEALTHCHECK").split(" CMD ", 1)[1])
    assert check[:2] == ["python", "/opt/valvemap/healthcheck.py"]
    everything = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    assert not re.search(r"curl|wget|apt-get|apk ", everything)


def test_the_service_is_process_one_and_is_stopped_like_by_ctrl_c():
    entry = exec_form(FINAL.last("ENTRYPOINT"))
    assert entry[:2] == ["/bin/sh", "-c"]
    assert entry[2].endswith('&& exec valvemap "$@"')
    assert exec_form(FINAL.last("CMD"))[0] == "serve"
    assert FINAL.last("STOPSIGNAL") == "SIGINT"


def test_the_kernels_are_compiled_ahead_for_any_machine_of_the_architecture():
    env = BUILD.env()
    assert "valvemap warm-up" in BUILD.all("RUN")
    assert env["NUMBA_CPU_NAME"] == FINAL.env()["NUMBA_CPU_NAME"] == "generic"
    assert env["NUMBA_CACHE_DIR"] == "/opt/valvemap/cache/numba"
    assert FINAL.env()["NUMBA_CACHE_DIR"] == "/tmp/cache/numba"


def test_the_environment_holds_no_secret():
    names = [*BUILD.env(), *FINAL.env(), *BUILD.all("ARG"), *FINAL.all("ARG")]
    assert not any(re.search("PASS|SECRET|TOKEN|KEY", name) for name in names)
    assert not FINAL.all("ADD")
    assert not BUILD.all("ADD")


def reaches_the_builder(path):
    rules = (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines()
    ignored = False
    for rule in filter(None, (line.split("#")[0].strip() for line in rules)):
        pattern = rule.removeprefix("!").removeprefix("**/")
        parts = [path, *map(str, Path(path).parents), *Path(path).parts]
        if any(fnmatch(part, pattern) for part in parts if part != "."):
            ignored = not rule.startswith("!")
    return not ignored


def test_the_builder_has_every_file_that_the_package_is_built_from():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    wheel = project["tool"]["hatch"]["build"]["targets"]["wheel"]
    hooks = {hook.get("path", "hatch_build.py") for hook in wheel["hooks"].values()}
    texts = {project["project"]["readme"], project["project"]["license-files"][0]}
    folders = {Path(package).parts[0] for package in wheel["packages"]}
    copied = {
        name.removeprefix("./") for argument in BUILD.all("COPY") for name in argument.split()
    }
    assert {"pyproject.toml", *hooks, *texts, *folders} <= copied


def test_only_what_the_image_is_made_of_reaches_the_builder():
    for stage in STAGES:
        for argument in stage.all("COPY"):
            if not argument.startswith("--from"):
                *sources, _ = argument.split()
                for source in sources:
                    assert (ROOT / source).exists(), source
                    assert reaches_the_builder(source), source
    for path in ("service/valvemap/errors.py", "virtual_rig/valvemap_rig/oil.py"):
        assert reaches_the_builder(path)
    for path in (
        ".git/config",
        ".venv/bin/python",
        "data/pki/key.pem",
        "tests/conftest.py",
        "service/__pycache__/errors.pyc",
    ):
        assert not reaches_the_builder(path), path


# -- docker-compose.yml


OF_FLEET = ("collect", "worker", "fleet-service")
ONCE = ("fleet-secrets", "fleet-topics", "fleet-access")
OURS = ("init", "connect", "rig", "service", "page", "rig-fleet", *ONCE, *OF_FLEET)


def test_the_file_is_valid_by_the_published_schema_of_compose():
    """Its origin: tests/data/README.md."""
    from jsonschema.validators import validator_for  # here: its import compiles 38 grammars, 2 s

    file = ROOT / "tests" / "data" / "compose_spec" / "compose-spec.json"
    schema = json.loads(file.read_text(encoding="utf-8"))
    validator = validator_for(schema)(schema)
    assert [f"{list(e.path)}: {e.message}" for e in validator.iter_errors(COMPOSE)] == []
    wrong = {**COMPOSE, "services": {"x": {"image": "y", "restrat": "no"}}}
    assert list(validator.iter_errors(wrong))


def test_every_variable_of_the_file_is_documented():
    """In the head of the file, or on a page."""
    text = (ROOT / "docker-compose.yml").read_text(encoding="utf-8")
    pages = [file.read_text(encoding="utf-8") for file in (ROOT / "docs").rglob("*.md")]
    known = "\n".join([text.partition("\nname:")[0], *pages])
    asked = set(re.findall(r"\$\{(\w+)", text))
    assert {name for name in asked if name not in known and not name.endswith("_PORT")} == {
        "VALVEMAP_SCENARIO"
    }


@pytest.mark.parametrize("name", OURS)
def test_every_container_is_locked_down(name):
    container = SERVICES[name]
    assert container["user"] == FINAL.last("USER")
    assert container["read_only"] is True
    assert container["cap_drop"] == ["ALL"]
    assert container["security_opt"] == ["no-new-privileges:true"]
    assert container["tmpfs"][0].startswith("/tmp:")
    data, *settings = container["volumes"]
    assert data == "data:/data"
    own = ["kafka-secrets:/kafka"] if name == "fleet-secrets" else []
    script = ["./container/own_source.sh:/own_source.sh:ro"] if name == "connect" else []
    assert settings in (script, ["./container/fleet:/fleet:ro", *own])
    assert not {"privileged", "cap_add", "devices", "pid", "ipc"} & set(container)
    assert container.get("network_mode") != "host"
    assert "data" in COMPOSE["volumes"]


def test_there_are_five_containers_and_more_to_watch_them_where_they_are_wanted():
    of_profile = {name: service.get("profiles") for name, service in SERVICES.items()}
    monitoring, scada, fleet = ["monitoring"], ["scada"], ["fleet"]
    assert of_profile == {
        **dict.fromkeys(["init", "connect", "rig", "service", "page"]),
        **dict.fromkeys(["prometheus", "grafana"], monitoring),
        **dict.fromkeys(["fuxa", "fuxa-project"], scada),
        **dict.fromkeys(["kafka", *ONCE, "rig-fleet", *OF_FLEET], fleet),
    }


@pytest.mark.parametrize("name", ["prometheus", "grafana", "fuxa"])
def test_what_watches_is_locked_down_too_and_changes_nothing(name):
    container = SERVICES[name]
    assert container["read_only"] is True
    assert container["cap_drop"] == ["ALL"]
    assert re.search(r":v?\d+\.\d+\.\d+$", container["image"])
    for volume in container["volumes"]:
        source, _, *read_only = volume.split(":")
        if source.startswith("./"):
            assert (ROOT / source).is_file()
            assert read_only == ["ro"]
        else:
            assert source in COMPOSE["volumes"]


def test_fuxa_s_project_is_loaded_by_a_container_that_changes_nothing_of_ours():
    loader = SERVICES["fuxa-project"]
    assert loader["user"] == FINAL.last("USER")
    assert loader["read_only"] is True
    assert loader["cap_drop"] == ["ALL"]
    mounted = {}
    for volume in loader["volumes"]:
        source, target, read_only = volume.split(":")
        assert read_only == "ro"
        mounted[target] = source
    assert mounted.pop("/data") == "data"
    assert all((ROOT / source).is_file() for source in mounted.values())
    assert set(loader["entrypoint"][1:]) == set(mounted)
    asked = load_project.arguments([*loader["entrypoint"][2:], *loader["command"]])
    assert asked.service == environment("page")["VALVEMAP_SERVICE_URL"]
    assert asked.user == "dashboard"
    assert asked.driver


def test_ports_are_published_on_loopback_alone():
    assert "ports" not in SERVICES["init"]
    assert "ports" not in SERVICES["fuxa-project"]
    ports = {"rig": 4840, "service": 4841, "page": 8080}
    watching = {"prometheus": 9090, "grafana": 3000, "fuxa": 1881}
    (published,) = SERVICES["fleet-service"]["ports"]
    assert published == "127.0.0.1:${VALVEMAP_FLEET_PORT:-4843}:4841"
    assert not [name for name in ("kafka", "collect", "worker") if "ports" in SERVICES[name]]
    for name, port in {**ports, **watching}.items():
        (published,) = SERVICES[name]["ports"]
        assert re.fullmatch(rf"127\.0\.0\.1:\$\{{\w+:-{port}\}}:{port}", published)


def test_init_runs_once_before_the_others_and_needs_no_network():
    assert SERVICES["init"]["command"] == ["init"]
    assert SERVICES["init"]["restart"] == "no"
    assert SERVICES["init"]["network_mode"] == "none"
    for name in ("rig", "service", "page"):
        waits = SERVICES[name]["depends_on"]
        assert waits["init"] == {"condition": "service_completed_successfully"}
    assert SERVICES["service"]["depends_on"]["rig"] == {"condition": "service_healthy"}


@pytest.mark.parametrize(("name", "port"), [("rig", "4840"), ("service", "4841")])
def test_health_of_each_is_asked_at_its_own_port(name, port):
    test = SERVICES[name]["healthcheck"]["test"]
    assert test == ["CMD", "python", "/opt/valvemap/healthcheck.py", port]


def environment(name):
    """The environment as compose makes it where nothing is set outside."""
    given = {k: v for k, v in SERVICES[name]["environment"].items() if v is not None}
    return {k: interpolated(v, {}) for k, v in given.items()}


def command_line(name):
    from valvemap.cli.command_table import load_command

    command = [interpolated(word, {}) for word in SERVICES[name]["command"]]
    return load_command(command[0]), command


@pytest.mark.parametrize("name", ["init", "rig"])
def test_the_commands_know_every_variable_that_they_are_given(name, monkeypatch):
    command, words = command_line(name)
    for variable, value in environment(name).items():
        monkeypatch.setenv(variable, value)
    known = {option.envvar: option.name for option in command.params if option.envvar}
    assert set(SERVICES[name]["environment"]) <= set(known)
    context = command.make_context(words[0], words[1:])
    assert str(context.params["data"]) == "/data"
    hosts = context.params["host" if name == "rig" else "rig_host"]
    assert list(hosts) == ["rig", "localhost"]


def test_the_page_s_variables_are_options_of_its_command(monkeypatch):
    command, words = command_line("page")
    for variable, value in environment("page").items():
        monkeypatch.setenv(variable, value)
    known = {option.envvar for option in command.params if option.envvar}
    assert set(SERVICES["page"]["environment"]) <= known
    options = command.make_context(words[0], words[1:]).params
    assert options["url"] == "opc.tcp://service:4841/valvemap/service/"
    assert options["listen"] == "0.0.0.0:8080"
    assert list(options["host_name"]) == ["page", "localhost"]
    url = interpolated(SERVICES["page"]["healthcheck"]["test"][-1], {})
    _, address, path = url.rpartition("127.0.0.1:8080")
    assert (address, path) == ("127.0.0.1:8080", "/livez")


def test_the_service_s_variables_are_fields_of_the_configuration(monkeypatch):
    from valvemap.config.loading import load_config

    command, words = command_line("service")
    command.make_context(words[0], words[1:])
    for variable, value in environment("service").items():
        monkeypatch.setenv(variable, value)
    config = load_config()
    rig = environment("rig")["VALVEMAP_RIG_URL"]
    assert config.source.url == rig.replace("0.0.0.0", "rig")
    assert config.server.url == "opc.tcp://0.0.0.0:4841/valvemap/service/"
    assert config.log.format == "json"
    assert config.source.security == "Basic256Sha256"


def test_the_page_has_https_where_it_is_asked_for():
    on = {
        name: interpolated(value, {"VALVEMAP_PAGE_HTTPS": "yes"})
        for name, value in RAW_PAGE.items()
    }
    assert on["VALVEMAP_PAGE_CERTIFICATE"] == on["VALVEMAP_PAGE_KEY"] == "/data/page.pem"
    assert environment("page")["VALVEMAP_PAGE_CERTIFICATE"] == ""
    url = SERVICES["page"]["healthcheck"]["test"][-1]
    assert interpolated(url, {}) == "http://127.0.0.1:8080/livez"
    assert interpolated(url, HTTPS) == "https://127.0.0.1:8080/livez"


HTTPS = {"VALVEMAP_PAGE_HTTPS": "yes"}
RAW_PAGE = SERVICES["page"]["environment"]


def container_run(words, folder, **env):
    """Run a container's words with /data and the mounted script below a folder."""
    data, script = folder / "data", ROOT / "container" / "own_source.sh"
    moved = {"/own_source.sh": str(script), "/data": str(data)}
    for place, there in moved.items():
        words = [word.replace(place, there) for word in words]
        env = {name: value.replace(place, there) for name, value in env.items()}
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    return words, {**env, "PATH": path, "VALVEMAP_DATA": str(data)}


def finished(words, folder, **env):
    words, own = container_run(words, folder, **env)
    return subprocess.run(
        words,
        env={**os.environ, **own},
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
    )


@pytest.mark.tutorial
@pytest.mark.timeout(400)
@pytest.mark.skipif(os.name != "posix", reason="the container's script is one of a POSIX shell")
def test_with_source_url_the_service_serves_the_valves_of_another_server(tmp_path):
    plant = Foreign(PLANT, ["Ventil 7"])
    plant.start()
    assert plant.ready.wait(30)
    try:
        outside = {"SOURCE_URL": plant.url}
        init = environment("init")
        done = finished(["valvemap", *SERVICES["init"]["command"]], tmp_path, **init)
        assert done.returncode == 0, done.stderr
        connect = SERVICES["connect"]
        given = {
            name: interpolated(value, outside)
            for name, value in connect["environment"].items()
            if value is not None
        }
        idle = finished(connect["entrypoint"], tmp_path, **{**given, "SOURCE_URL": ""})
        assert (idle.returncode, idle.stdout) == (0, "")
        words = [*connect["entrypoint"], "--watch", "5"]
        done = finished(words, tmp_path, **given)
        assert done.returncode == 0, done.stdout + done.stderr
        file = tmp_path / "data" / "own" / "service.toml"
        before = file.read_text(encoding="utf-8")
        again = finished(connect["entrypoint"], tmp_path, **given)
        assert (again.returncode, file.read_text(encoding="utf-8")) == (0, before)
        check_it_serves(tmp_path, outside)
    finally:
        plant.over.set()
        plant.join(30)


def check_it_serves(folder, outside):
    service, port = SERVICES["service"], free_port()
    own = {
        name: interpolated(value, outside).replace("0.0.0.0:4841", f"127.0.0.1:{port}")
        for name, value in service["environment"].items()
        if value is not None
    }
    command = [interpolated(word, outside) for word in service["command"]]
    assert command[-1] == "/data/own/service.toml"
    words, own = container_run(["valvemap", *command], folder, **own)
    log = folder / "service.log"
    with program(*words, env=own, log=log, cwd=folder) as process:
        wait_for(log, "source connected", process, 200.0)
        wait_for(log, "results served", process, 200.0)
    assert process.returncode == 0, log.read_text()


def test_the_fleet_is_one_that_its_commands_understand(monkeypatch):
    """Every path of its files lies in the containers, every valve is one that its rig plays."""
    pytest.importorskip("confluent_kafka")
    from valvemap.kafka.catalogue import load_catalogue
    from valvemap.kafka.settings import load_fleet
    from valvemap.kafka.topics import wanted
    from valvemap_rig.fleet import valve_names
    from valvemap_rig.scenario import Fleet, Scenario

    fleet = load_fleet(ROOT / "container" / "fleet" / "fleet.toml")
    known = load_catalogue(fleet.catalogue)
    (site,) = known.sites.values()
    words = SERVICES["rig-fleet"]["command"]
    playing = Scenario(fleet=Fleet(valves=int(words[words.index("--valves") + 1])))
    assert [valve.name for valve in site.valves] == valve_names(playing)
    assert site.source.url == environment("rig-fleet")["VALVEMAP_RIG_URL"].replace(
        "0.0.0.0", "rig-fleet"
    )
    assert fleet.broker.addresses == ("kafka:9092",)
    kafka = SERVICES["kafka"]["environment"]
    listeners = kafka["KAFKA_ADVERTISED_LISTENERS"].split(",")
    assert listeners == ["CLIENTS://kafka:9092", "OWN://localhost:9094"]
    assert "CLIENTS:SASL_SSL" in kafka["KAFKA_LISTENER_SECURITY_PROTOCOL_MAP"].split(",")
    assert fleet.broker.tls
    for name in ("fleet-topics", "fleet-access", *OF_FLEET):
        own = environment(name)
        user = own["VALVEMAP_FLEET_BROKER__USER"]
        assert own["VALVEMAP_FLEET_BROKER__PASSWORD_FILE"] == f"/data/kafka/{user}-password"
    largest = {topic.settings["max.message.bytes"] for topic in wanted(fleet.topics)}
    assert largest == {SERVICES["kafka"]["environment"]["KAFKA_MESSAGE_MAX_BYTES"]}
    assert SERVICES["worker"]["deploy"]["replicas"] <= fleet.topics.partitions
    for path in (fleet.collect.spool, fleet.work.state, site.security.pki, site.security.users):
        assert str(path).startswith(("/data/", "/tmp/")), path
    for name in ("fleet-topics", *OF_FLEET):
        group, (word, command, *options) = fleet_command(), SERVICES[name]["command"]
        assert word == "fleet"
        context = group.commands[command].make_context(command, options)
        assert str(context.params["config"]) == "/fleet/fleet.toml"


def fleet_command():
    from valvemap.cli.command_table import load_command

    return load_command("fleet")


# -- the health check


def healthcheck(port):
    return subprocess.run(
        [sys.executable, ROOT / "container" / "healthcheck.py", str(port)],
        capture_output=True,
        text=True,
        timeout=30,
        check=False,
    )


@pytest.mark.parametrize(
    ("answer", "code"), [(b"ACKF\x1c\0\0\0", 0), (b"ERRF\x10\0\0\0", 1), (b"", 1)]
)
def test_a_server_is_healthy_if_it_acknowledges_hello(answer, code):
    heard = []
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve():
            connection, _ = server.accept()
            with connection:
                heard.append(connection.recv(1000))
                connection.sendall(answer)

        thread = threading.Thread(target=serve)
        thread.start()
        result = healthcheck(server.getsockname()[1])
        thread.join()
    assert result.returncode == code, result.stderr
    assert heard[0][:4] == b"HELF"
    assert int.from_bytes(heard[0][4:8], "little") == len(heard[0])


def test_where_nobody_listens_nobody_is_healthy():
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    result = healthcheck(port)
    assert result.returncode == 1
    assert result.stderr.startswith(f"port {port}: ")


# -- the image's steps, without an engine


class Build:
    """Carries out a Dockerfile's steps below a folder: its absolute paths are moved there."""

    def __init__(self, root):
        self.root = root
        (root / "tmp").mkdir()
        self.stub = root / "stub"
        self.stub.mkdir()
        (self.stub / "chown").symlink_to(shutil.which("true"))
        (self.stub / "python").write_text(f'#!/bin/sh\nexec "{sys.executable}" "$@"\n')
        (self.stub / "python").chmod(0o755)
        self.start_stage()

    def start_stage(self):
        self.env = {"PATH": f"{self.stub}:{os.environ['PATH']}"}
        self.workdir = self.root

    def moved(self, text):
        return re.sub(r"(?<![\w.:/-])/(opt/valvemap|src|data|tmp)\b", rf"{self.root}/\1", text)

    def run(self, words):
        result = subprocess.run(
            words,
            cwd=self.workdir,
            env=self.env,
            capture_output=True,
            text=True,
            timeout=900,
            check=False,
        )
        assert result.returncode == 0, f"{words}\n{result.stdout}\n{result.stderr}"
        return result.stdout

    def step(self, instruction, argument):
        match instruction:
            case "ENV":
                for pair in shlex.split(argument):
                    name, value = pair.split("=", 1)
                    value = self.moved(value).replace("$PATH", self.env["PATH"])
                    self.env[name] = value
            case "WORKDIR":
                self.workdir = Path(self.moved(argument))
                self.workdir.mkdir(parents=True, exist_ok=True)
            case "COPY":
                words = [word for word in argument.split() if not word.startswith("--chown")]
                if words[0].startswith("--from"):
                    assert words[1] == words[2], "the stages share one folder here"
                    assert Path(self.moved(words[1])).exists()
                else:
                    self.copy(words[:-1], words[-1])
            case "RUN":
                self.run(["/bin/sh", "-c", self.moved(argument)])

    def copy(self, sources, target):
        into = self.workdir / self.moved(target)
        for source in sources:
            if (ROOT / source).is_dir():
                shutil.copytree(ROOT / source, into, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                shutil.copy(ROOT / source, into)


_MOST_BYTES = 430 * 1024 * 1024  # of /opt/valvemap


@pytest.fixture
def build(tmp_path):
    yield Build(tmp_path)
    shutil.rmtree(tmp_path)  # hundreds of megabytes


@pytest.mark.image
@pytest.mark.soak
@pytest.mark.timeout(1800)
@pytest.mark.skipif(os.name != "posix", reason="the image's steps are those of a POSIX shell")
def test_the_image_s_steps_build_something_that_runs(build):
    for stage in STAGES:
        build.start_stage()
        for instruction, argument in stage.steps:
            build.step(instruction, argument)

    opt = build.root / "opt" / "valvemap"
    files = [file for file in opt.rglob("*") if file.is_file() and not file.is_symlink()]
    assert sum(file.stat().st_size for file in files) < _MOST_BYTES

    warm = build.root / "opt" / "valvemap" / "cache" / "numba"
    compiled = {file.relative_to(warm) for file in warm.rglob("*.nbc")}
    assert len(compiled) > 10

    entry = [build.moved(word) for word in exec_form(FINAL.last("ENTRYPOINT"))]
    assert "serve" in build.run([*entry, "--help"])
    build.run([*entry, *SERVICES["init"]["command"]])
    assert (build.root / "data" / "service.toml").exists()
    build.run([*entry, "check-config", str(build.root / "data" / "service.toml")])

    build.run([*entry, "warm-up"])
    copied = build.root / "tmp" / "cache" / "numba"
    assert {file.relative_to(copied) for file in copied.rglob("*.nbc")} == compiled
