"""What tables show of entrants: their names, and which of them are controls."""

import json

import pandas as pd
import pytest

from geoevs.core.errors import GeoEvsError
from geoevs.core.files import write_json
from geoevs.results.entrants import Entrants, Info
from geoevs.results.paper import paper_method, paper_values


def test_names_are_the_papers_else_the_methods_own():
    entrants = Entrants({"three-dgs": Info("My 3DGS"), "mine.wide": Info("Mine")})
    assert entrants.name("three-dgs") == "3DGS"
    assert entrants.name("geo-evs", "v2") == "Geo-EVS (v2)"
    assert entrants.name("mine", "wide") == "Mine (wide)"
    assert entrants.name("unheard-of") == "unheard-of"


def test_a_name_that_two_methods_have_tells_whose_it_is():
    copies = {
        "mine": Info("Mine"),
        "copy": Info("Mine"),
        "copy.wide": Info("Mine"),
    }
    entrants = Entrants(copies)
    assert entrants.name("mine") == "Mine [mine]"
    assert entrants.name("copy") == "Mine [copy]"
    assert entrants.name("copy", "wide") == "Mine (wide)"


def test_a_nameless_method_has_its_bare_name():
    assert Entrants({"mine.wide": Info("")}).name("mine", "wide") == "mine (wide)"


@pytest.mark.parametrize("said", [None, [], {}, 3, True])
def test_what_is_no_text_describes_nobody(tmp_path, said):
    who = {"name": "A", "paradigm": "", "extra_prior": "", "needs": "", "sees": ""}
    write_json(tmp_path / "entrants.json", {"a": {**who, "needs": said}})
    with pytest.raises(GeoEvsError, match=r"entrants\.json does not say who plays"):
        Entrants.read(tmp_path / "entrants.json")


def test_the_paradigm_alone_makes_a_control():
    entrants = Entrants({"flat": Info("Flat", "control"), "reproject": Info("R", "diffusion")})
    assert entrants.is_control("flat")
    assert not entrants.is_control("flat", "other")
    assert not entrants.is_control("reproject")
    assert not entrants.is_control("unheard-of")


def test_a_table_is_described_behind_its_own_columns():
    table = pd.DataFrame({"method": ["a", "b"], "variant": ["default", "wide"]}, index=[4, 2])
    made = Entrants({"b.wide": Info("B", "control", "none", "lidar", "views")}).describe(table)
    assert made.loc[4].tolist() == ["a", "default", "a", "", "", "", ""]
    assert made.loc[2].tolist() == ["b", "wide", "B (wide)", "control", "none", "lidar", "views"]
    assert list(Entrants({}).describe(table[:0]))[2:] == [
        "name",
        "paradigm",
        "extra_prior",
        "needs",
        "sees",
    ]


def test_every_method_of_the_papers_tables_has_its_name():
    tables = ("observed", "extrapolation", "pose_offset", "sparsity", "ablation", "interpolation")
    for table in tables:
        for method in paper_values(table):
            assert paper_method(method)["name"]


@pytest.mark.parametrize("text", ['["mine"]', '{"mine": {"name": "Mine"}}', '{"mine": 3}'])
def test_a_file_of_another_shape_is_named(tmp_path, text):
    path = tmp_path / "entrants.json"
    write_json(path, json.loads(text))
    with pytest.raises(GeoEvsError, match="does not say who plays; delete it and make it again"):
        Entrants.read(path)
