from pathlib import Path

from valvemap.config.loading import load_config
from valvemap.config.models import Config
from valvemap.config.template import configuration_template
from valvemap.config.valves import NodesConfig

SHIPPED = Path(__file__).parents[2] / "config" / "service.toml"


def test_the_shipped_configuration_is_what_init_writes():
    assert SHIPPED.read_text(encoding="utf-8") == configuration_template(Path("data"))


def test_the_template_says_what_would_hold_without_it_but_for_the_user():
    config = load_config(SHIPPED)
    assert config.valves == Config().valves
    assert config.valves[0].nodes == NodesConfig.of_rig("Valvistor")
    source = config.source.model_copy(update={"user": None, "password_file": None})
    assert source == Config().source
    assert config.alignment == Config().alignment


def test_a_windows_path_survives_the_template(tmp_path):
    file = tmp_path / "service.toml"
    text = configuration_template(Path(r"C:\valve maps\data"), ["plant-7"])
    file.write_text(text, encoding="utf-8")
    config = load_config(file)
    assert "valve maps" in str(config.security.users)
    assert config.server.host_names == ("plant-7",)
