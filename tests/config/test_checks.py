import copy
from pathlib import Path

import pytest
import yaml

import baselines
from geoevs.config.checks import check_config
from geoevs.config.entrants import method_entries, stability_entries
from geoevs.config.partitions import expand_scenes, partition_scenes
from geoevs.core.errors import GeoEvsError
from geoevs.protocol.stressors import STRESSORS, Stressor
from geoevs.scenes.scene import find_sources

PROJECT = Path(__file__).parents[2]
SCHEMA = PROJECT / "workflow/schemas/config.schema.yaml"
VALID = """\
run: test
seed: 3
resolution: [48, 72]
evaluate: [real]
datasets:
  real:
    source: pandaset
    options: {folder: there}
    partitions:
      train: ["001", "002@0-9"]
      test: ["002@10-19"]
protocol:
  lateral: [-1, 1]
  pose_sweep: {angles: [5], every: 2}
  reference_keep: [1.0, 0.5]
  masked: {yaw: [10], lateral: [-3, 3], every: 1}
budget: {fit_seconds: null, limits: {fit: 9, render: 9, training: null}}
methods:
  reference: {}
  reproject-inpaint.best: {options: {inpaint: fsr-best}, seeds: [0, 2]}
  mean-colour: null
tables:
  ablation: reproject-inpaint
  pose_bins: [0, 10]
  support_bins: [0, 0.1]
  resamples: 100
  confidence: 0.95
geometry:
  model: lidar
  weights: null
  supervision: dense
  finetune: {steps: 2, batch: 1, learning_rate: 0.001}
weights: somewhere
pretrain:
  {vggt-nano: &o {steps: 3, batch: 2, learning_rate: 0.01}, depth-refiner: *o, autoencoder: *o,
  prior: *o}
conditions:
  masks: {yaw: [0, 1], lateral: [-2, 2]}
trainings: {}
cluster: {gpu: 0}
stability:
  datasets: []
  seeds: 2
  lateral: [0.5]
  levels:
    {support: [0.02], beams: [], rotation: [], translation: [], cameras: [], exposure: [],
     motion: [], lateral: [], yaw: [], edges: []}
  methods: {reproject-inpaint.best: {inpaint: telea}}
detection: {methods: {}}
"""


@pytest.fixture
def check(tmp_path):
    """Checks the valid config after some text of it was replaced."""

    def run(old: str, new: str) -> None:
        assert VALID.count(old) == 1
        path = tmp_path / "config.yaml"
        path.write_text(VALID.replace(old, new))
        check_config(yaml.safe_load(path.read_text()), SCHEMA, [path])

    return run


def merged(*texts: str) -> dict:
    """Configs put together as Snakemake does: deeply, the later one winning."""

    def update(base, other):
        for key, value in other.items():
            if isinstance(value, dict) and isinstance(base.get(key), dict):
                update(base[key], value)
            else:
                base[key] = copy.deepcopy(value)
        return base

    result = {}
    for text in texts:
        update(result, yaml.safe_load(text) or {})
    return result


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("datasets: []", "datasets: [reel]", "no data set 'reel' .*did you mean 'real'"),
        ("datasets: []", "datasets: [real]", "'real' is under 'evaluate' too"),
        ("support: [0.02]", "support: [0.02], support: [0.03]", "'support' stands in line"),
        (
            "support: [0.02]",
            "suport: [0.02]",
            r"config.yaml:\d+: there is no stressor 'suport'; did you mean 'support'",
        ),
        ("support: [0.02]", "support: [-1]", "-1 is too small; make it 0 or more"),
        (
            "lateral: [-1, 1]",
            "lateral: [-1, 1.0000001, 1]",
            r"config.yaml:13: 'protocol.lateral' has 1.0000001 and 1, whose files would overwrite",
        ),
        (
            "masked: {yaw: [10]",
            "masked: {yaw: [10, 10.0000001]",
            r"config.yaml:16: 'protocol.masked.yaw' has 10 and 10.0000001, whose files",
        ),
        (
            "support: [0.02]",
            "support: [0.02, 0.020000001]",
            r"'stability.levels.support' has 0.02 and 0.020000001, whose files would overwrite",
        ),
        ("best: {inpaint: telea}", "worst: {}", "no 'reproject-inpaint.worst' under 'methods'"),
        ("{inpaint: telea}", "{paint: 1}", "'paint'"),
        ("best: {inpaint: telea}", "best: {}, reference: {}", "nothing that could be stressed"),
    ],
)
def test_a_mistake_in_stability_is_one_sentence(check, old, new, sentence):
    with pytest.raises(GeoEvsError, match=sentence):
        check(old, new)


def test_stability_takes_the_first_seed_and_its_own_options():
    (entry,) = stability_entries(yaml.safe_load(VALID))
    assert (entry.label, entry.seed) == ("reproject-inpaint.best.seed3", 3)
    assert entry.options == {"inpaint": "telea"}


def test_only_worlds_that_a_source_can_make_are_asked_for():
    config = yaml.safe_load(VALID)
    config["datasets"]["stressed"] = config["datasets"]["real"] | {"partitions": {}}
    config["stability"]["datasets"] = ["stressed"]
    check_config(config, SCHEMA, [])
    config["stability"]["levels"]["motion"] = [5]
    sentence = "'pandaset' has no option 'traffic_speed'.* 'motion' sets that .* an empty list"
    with pytest.raises(GeoEvsError, match=sentence):
        check_config(config, SCHEMA, [])
    del config["stability"]["levels"]["motion"]  # its own levels
    with pytest.raises(GeoEvsError, match=sentence):
        check_config(config, SCHEMA, [])


def test_a_new_stressor_needs_no_change_of_the_schema(check, monkeypatch):
    check("support: [0.02], ", "")
    grain = Stressor("rays of a pixel", kind="world", levels=(8,), option="samples")
    monkeypatch.setitem(STRESSORS, "grain", grain)
    check("support: [0.02]", "grain: [8, 4]")
    config = yaml.safe_load(VALID)
    config["stability"]["levels"]["grain"] = [8]
    config["datasets"]["stressed"] = config["datasets"]["real"] | {"partitions": {}}
    config["stability"]["datasets"] = ["stressed"]
    with pytest.raises(GeoEvsError, match="'pandaset' has no option 'samples'"):
        check_config(config, SCHEMA, [])


def test_the_default_levels_are_those_of_the_config():
    config = yaml.safe_load((PROJECT / "config.yaml").read_text())
    levels = config["stability"]["levels"]
    assert levels == {name: list(STRESSORS[name].levels) for name in levels}


def test_a_valid_config_passes(check):
    check("seed: 3", "seed: 4")


SCALES = sorted(path.stem for path in (PROJECT / "workflow/scales").glob("*.yaml"))


@pytest.mark.parametrize("scale", [None, *SCALES])
def test_the_shipped_configs_pass(scale):
    if scale == "waymo-mini" and "waymo" not in find_sources():
        pytest.skip("there is no data source 'waymo' yet")
    overlays = {None: [], "filled-holes": ["ablation", scale]}.get(scale, [scale])
    files = [PROJECT / "config.yaml"]
    files += [PROJECT / f"workflow/scales/{overlay}.yaml" for overlay in overlays]
    check_config(merged(*(file.read_text() for file in files)), SCHEMA, files)


MISTAKES = {
    "unknown key": ("seed: 3", "seeed: 3", "2: 'seeed' is not a known key; did you mean 'seed'?"),
    "unknown nested key": (
        "  pose_bins: [0, 10]",
        "  pose_bin: [0, 10]",
        "24: 'pose_bin' is not a known key; did you mean 'pose_bins'? (one of: ablation, ",
    ),
    "unknown key in a flow": ("every: 2", "evry: 2", "14: 'evry' is not a known key; did you "),
    "a number as key": ("seed: 3", "3: seed", "2: YAML does not read the key '3' as text; w"),
    "missing key": ("seed: 3\n", "", "the key 'seed' is missing at the top level; add it"),
    "missing nested key": (
        ", every: 2",
        "",
        "14: the key 'every' is missing under 'protocol.pose_sweep'; add it",
    ),
    "wrong type": (
        "seed: 3",
        "seed: three",
        "2: 'seed' is wrong: 'three' is of another t",
    ),
    "no list": (
        "[48, 72]",
        "48",
        "3: 'resolution' is wrong: 48 is of another type; write a list, such as [1, 2]",
    ),
    "one size": (
        "[48, 72]",
        "[48]",
        "3: 'resolution' is wrong: [48] is too short; write 2",
    ),
    "too small": ("[48, 72]", "[48, 2]", "3: 'resolution.1' is wrong: 2 is too small; make it 16"),
    "null": (
        "confidence: 0.95",
        "confidence: null",
        "27: 'tables.confidence' is wrong: null",
    ),
    "a run that is a path": ("run: test", "run: ../a", "1: '../a' is not an allowed name; use "),
    "a data set that is a path": (
        "  real:\n",
        "  ../real:\n",
        "6: '../real' is not an allowed name; use lower case and hyphens",
    ),
    "a method in capitals": ("  reference:", "  Reference:", "19: 'Reference' is not an allowed"),
    "unknown data set": (
        "evaluate: [real]",
        "evaluate: [reel]",
        "4: there is no data set 'reel' under 'datasets'; did you mean 'real'? (one of: real)",
    ),
    "unknown source": (
        "source: pandaset",
        "source: panda",
        "7: there is no data source called 'panda'; did you mean 'pandaset'?",
    ),
    "unknown source option": (
        "{folder: there}",
        "{foldr: there}",
        "8: data source 'pandaset' has no option 'foldr'; did you mean 'folder'?",
    ),
    "missing source option": (
        "{folder: there}",
        "{}",
        "8: data source 'pandaset' needs the option 'folder'; set it in its options",
    ),
    "unknown method": (
        "  reference:",
        "  refrence:",
        "19: there is no method 'refrence'; did you mean 'reference'? (one of: emernerf, ",
    ),
    "unknown method option": (
        "{inpaint: fsr-best}",
        "{inpant: fsr-best}",
        "20: method 'reproject-inpaint.best' has no option 'inpant'; did you mean 'inpaint'?",
    ),
    "an option of the reference": (
        "reference: {}",
        "reference: {options: {a: 1}}",
        "19: the control 'reference' has no options; remove them",
    ),
    "one label twice": (
        "reference: {}",
        "reproject.default: {}\n  reproject: {}",
        "20: two entrants are called 'reproject.seed3'; rename one variant",
    ),
    "overlapping ranges": (
        '"002@10-19"',
        '"002@9-19"',
        "9: data set 'real' has scene '002@0-9' in partition 'train' and '002@9-19' in 'test'; ",
    ),
    "a whole scene and a range of it": ('"002@10-19"', '"002"', "9: data set 'real' has scene "),
    "an overlap within a partition": (
        '"001", "002@0-9"',
        '"001", "001@3-4"',
        "9: data set 'real' has scene '001' in partition 'train' and '001@3-4' in 'train'; ",
    ),
    "a scene that leaves its folder": ('"002@10-19"', '".."', "11: scene '..' is not of the form"),
    "a scene in another folder": ('"002@10-19"', '"a/b"', "11: scene 'a/b' is not of the form"),
    "a number as scene": ('"002@10-19"', "2", "11: 'datasets.real.partitions.test.0' is wrong: 2"),
    "no test scene": (
        '["002@10-19"]',
        "[]",
        "4: data set 'real' has no test scenes; name some under its partitions.test, or do not ",
    ),
    "no test partition": ('      test: ["002@10-19"]\n', "", "4: data set 'real' has no te"),
    "a range that falls": ('"001"', "a-9..8", "10: scene 'a-9..8' is not of the form NAME, NA"),
    "a range of names": ('"001"', "a-1..a-2", "10: scene 'a-1..a-2' is not of the form NAME, NA"),
    "a range of ranges": ('"001"', "003@0..9", "10: scene '003@0..9' is not of the form NAME, NA"),
    "a range with a scene that is tested": (
        '"001", "002@0-9"',
        '"001..003"',
        "9: data set 'real' has scene '002' in partition 'train' and '002@10-19' in 'test'; ",
    ),
    "unknown depth model": (
        "model: lidar",
        "model: vggt-nan",
        "29: there is no depth model 'vggt-nan'; did you mean 'vggt-nano'? (one of: depth-",
    ),
    "a depth model without weights": (
        "model: lidar",
        "model: vggt-1b",
        "30: depth model 'vggt-1b' needs weights; give their path",
    ),
    "a depth model that cannot learn": (
        "model: lidar\n  weights: null",
        "model: depth-anything-3\n  weights: there",
        "32: depth model 'depth-anything-3' cannot be fine-tuned; set 'finetune' to null",
    ),
    "nothing to fine-tune on": (
        "model: lidar",
        "model: vggt-nano",
        "32: there are no scenes to fine-tune 'vggt-nano' on; name some under partitions.geom",
    ),
    "fine-tuning of no steps": (
        "steps: 2,",
        "steps: 0,",
        "32: 'geometry.finetune.steps' is wrong: 0 is too small; make it 1 or more (it means: Opt",
    ),
    "an unknown supervision": (
        "supervision: dense",
        "supervision: sparse",
        "31: 'geometry.supervision' is wrong: there is no 'sparse'; one of: dense, lidar (it means",
    ),
    "no pretraining": (
        "prior: *o",
        "prior: null",
        "36: 'pretrain.prior' is wrong: null is of another type; write NAME: VALUE, ",
    ),
    "edges that fall": (
        "pose_bins: [0, 10]",
        "pose_bins: [0, 10, 5]",
        "24: the edges must rise; sort them and drop repeats",
    ),
    "edges that repeat": ("[0, 0.1]", "[0, 0.1, 0.1]", "25: the edges must rise"),
    "nobody who is left out": (
        "mean-colour: null",
        "mean-color: null",
        "21: there is no method 'mean-color'; did you mean 'mean-colour'",
    ),
    "ablation of nobody": (
        "ablation: reproject-inpaint",
        "ablation: reproject.wide",
        "23: there is no method 'reproject.wide'; did you mean 'reproject'",
    ),
    "ablation of an oracle": (
        "ablation: reproject-inpaint",
        "ablation: truth",
        "23: there is no method 'truth'; ",
    ),
    "one edge": ("pose_bins: [0, 10]", "pose_bins: [0]", "24: 'tables.pose_bins' is wrong: [0]"),
    "a shift twice": ("[-1, 1]", "[1, 1]", "13: 'protocol.lateral' is wrong: [1, 1] has somethi"),
    "an angle twice": ("[5]", "[5, 5.0]", "14: 'protocol.pose_sweep.angles' is wrong: [5, 5.0]"),
    "a mask beyond the side camera": (
        "[0, 1], lateral",
        "[0, 1.5], lateral",
        "38: 'conditions.masks.yaw.1' is wrong: 1.5 is too large; make it 1 or less",
    ),
    "a mask that tests": (
        "[-2, 2]",
        "[-2, 3]",
        "38: masks shifted by 3 m are what protocol.masked tests with; change one of them",
    ),
    "no masks": ("[-2, 2]", "[]", "38: 'conditions.masks.lateral' is wrong: [] "),
    "no mask": ("yaw: [10]", "yaw: []", "16: 'protocol.masked.yaw' is wrong: [] is too short; w"),
    "a GPU lent out": ("gpu: 0", "gpu: -1", "40: 'cluster.gpu' is wrong: -1 is too small; make"),
    "no time": ("fit_seconds: null", "fit_seconds: 0", "17: 'budget.fit_seconds' is wrong: 0 is"),
}


@pytest.mark.parametrize("kind", MISTAKES)
def test_a_mistake_is_one_sentence_with_its_line(check, tmp_path, kind):
    old, new, sentence = MISTAKES[kind]
    with pytest.raises(GeoEvsError) as caught:
        check(old, new)
    found = str(caught.value)
    assert "\n" not in found
    assert found.removeprefix(f"{tmp_path / 'config.yaml'}:").lstrip().startswith(sentence)


def test_the_later_file_is_blamed_only_for_what_it_sets(tmp_path):
    base, over, empty = (tmp_path / name for name in ("base.yaml", "over.yaml", "empty.yaml"))
    base.write_text(VALID)
    empty.write_text("{}\n")

    def sentence(text: str) -> str:
        over.write_text(text)
        with pytest.raises(GeoEvsError) as caught:
            check_config(merged(VALID, text), SCHEMA, [base, over, empty])
        return str(caught.value)

    assert sentence("\nprotocol:\n  pose_sweep: {every: 0}\n").startswith(f"{over}:3: 'protocol")
    assert sentence("seed: x").startswith(f"{over}:1: 'seed' is wrong")
    assert sentence("evaluate: [none]").startswith(f"{over}:1: there is no data set 'none'")
    # Another source: its options are the base's, and wrong for it there.
    street = sentence("datasets: {real: {source: street}}")
    assert street.startswith(f"{base}:8: data source 'street' has no option 'folder'")


def test_data_sets_of_one_source_share_scenes_within_a_partition_only(check):
    def second(scenes: str) -> str:
        options = "source: pandaset, options: {folder: there}"
        return f"  again: {{{options}, partitions: {{test: [{scenes}]}}}}\nprotocol:"

    check("protocol:", second('"002@15-30"'))
    with pytest.raises(GeoEvsError, match=r":12: data set 'again' has scene '002@5-12' in part"):
        check("protocol:", second('"002@5-12"'))


@pytest.mark.parametrize("other", ["pretrain", "geometry", "validation", "test"])
def test_no_frame_trains_and_serves_another_partition(check, other):
    trained = 'train: ["001", "002@0-9"]'
    shared = {"test": '"002@9-19"'}.get(other, '"002@10-19"')
    partition = "" if other == "test" else f'{other}: ["002@9-9"]\n      '
    with pytest.raises(GeoEvsError, match=r"has scene '002@.*; a frame may serve one partition"):
        check(
            f'{trained}\n      test: ["002@10-19"]', f"{trained}\n      {partition}test: [{shared}]"
        )


def test_a_method_that_lacks_a_package_is_named(check, tmp_path, monkeypatch):
    (tmp_path / "needy").mkdir()
    (tmp_path / "needy/adapter.py").write_text("import no_such_package\n")
    monkeypatch.setattr(baselines, "__path__", [*baselines.__path__, str(tmp_path)])
    with pytest.raises(GeoEvsError, match=r"method 'needy' cannot be imported \(ModuleNotFound"):
        check("reference: {}", "needy: {options: {a: 1}}")


def test_a_folder_with_the_name_of_a_control_is_refused(check, tmp_path, monkeypatch):
    (tmp_path / "truth").mkdir()
    (tmp_path / "truth/adapter.py").write_text("")
    monkeypatch.setattr(baselines, "__path__", [*baselines.__path__, str(tmp_path)])
    with pytest.raises(GeoEvsError, match=r"^baselines/truth/adapter.py: 'truth' is the contr"):
        check("seed: 3", "seed: 4")


def test_a_method_that_cannot_be_imported_fails_alone(check, tmp_path, monkeypatch):
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken/adapter.py").write_text("raise ValueError('half written')\n")
    monkeypatch.setattr(baselines, "__path__", [*baselines.__path__, str(tmp_path)])
    check("reference: {}", "broken: {}")


def test_networks_need_scenes_or_stay_as_they_are(check):
    network = "model: lidar\n  weights: null\n  supervision: dense\n  finetune:"
    finetune = "{steps: 2, batch: 1, learning_rate: 0.001}"
    check(f"{network} {finetune}", f"{network} null".replace("lidar", "vggt-nano"))
    changed = f"{network} null".replace("lidar", "depth-anything-3").replace("null", "there", 1)
    check(f"{network} {finetune}", changed)


def test_scenes_of_a_partition_in_order():
    datasets = {
        "b": {"partitions": {"train": ["x", "y-98..101"], "test": ["t"]}},
        "a": {"partitions": {"train": ["007..008"]}},
        "c": {"partitions": {}},
    }
    config = {"datasets": datasets}
    assert partition_scenes(config, "train", datasets) == [
        *(("b", scene) for scene in ("x", "y-98", "y-99", "y-100", "y-101")),
        *(("a", scene) for scene in ("007", "008")),
    ]
    assert partition_scenes(config, "test", ["a"]) == []
    assert expand_scenes(["curve-5..5", "1..3"]) == ["curve-5", "1", "2", "3"]


def test_entries_have_the_runs_seed_added_and_skip_null():
    labels = [entry.label for entry in method_entries(yaml.safe_load(VALID))]
    assert labels == [
        "reference.seed3",
        "reproject-inpaint.best.seed3",
        "reproject-inpaint.best.seed5",
    ]
