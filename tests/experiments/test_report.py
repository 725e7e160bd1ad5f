"""Reports of experiments: the numbers, the verdicts, and that the page is whole, harmless and needs nothing beside
it."""

import base64
import csv
import hashlib
import io
import math
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image
from scipy import stats

pytest.importorskip("pandas")
pytest.importorskip("matplotlib")
pytest.importorskip("jinja2")

import pandas as pd

from clcache.experiments.configuration import Configuration
from clcache.experiments.experiment import Claim, Column, Experiment, Labelled, Plot, Table
from clcache.experiments.job import Job, Result
from clcache.experiments.pictures import QUALITIES, difference, places, strips
from clcache.experiments.report import write_csv, write_index, write_report
from clcache.experiments.summary import Estimate, equals, judge, meet, printed, summarise, tidy, verdicts

HOSTILE = "<script>alert('&\"')</script>"
VOID = {"meta", "img", "input", "br", "link", "rect", "path", "circle"}


def labelled(rows, scene="box", seed=1, arrays=None, kind="sequence", **parameters):
    """What one job found. seed None: of a job that is told none."""
    told = parameters | ({} if seed is None else {"seed": seed}) | {"told": scene}
    about = {"host": "here", "processor": "a processor", "version": "1", "began": 1.7e9 + (seed or 0), "seconds": 2.0}
    return Labelled({"scene": scene, "seed": seed or 1}, Job(kind, told)), Result(rows, arrays or {}, about)


def rows_of(values, column="value", **own):
    """A job for each seed, which found one row."""
    return tidy([labelled([{"configuration": "a", column: v, **own}], seed=n) for n, v in enumerate(values, 1)])


def cells(file):
    with file.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


# ---------------------------------------------------------------------------------------------------------------------
# Numbers


def test_frames_are_brought_together_and_then_seeds():
    seconds = {1: [9.0, 1.0, 2.0, 6.0], 2: [9.0, 4.0, 5.0, 9.0], 3: [9.0, 2.0, 2.0, 2.0]}
    found = [
        labelled(
            [
                {"configuration": "a", "frame": n, "counted": n > 0, "seconds": s, "flip": s if n % 2 else None}
                for n, s in enumerate(values)
            ],
            seed=seed,
        )
        for seed, values in seconds.items()
    ]
    rows = tidy(found)
    medians = [np.median(values[1:]) for values in seconds.values()]
    means = [np.mean(values[1::2]) for values in seconds.values()]
    for column, expected in (("seconds", medians), ("flip", means)):
        (one,) = summarise(rows, ("scene", "configuration"), Column(column, "")).values()
        assert one.mean == pytest.approx(np.mean(expected))
        assert one.error == pytest.approx(np.std(expected, ddof=1) / math.sqrt(3))
        assert one.n == 3
    assert summarise(rows, ("scene", "configuration"), Column("absent", "")) == {}
    assert summarise(rows, ("absent",), Column("seconds", "")) == {}


def test_what_is_divided_is_divided_in_the_same_job_and_by_the_same_seed():
    def job(seed, base, own, plan):
        rows = [{"configuration": "base", "seconds": base}, {"configuration": f"own {plan}", "seconds": own}]
        return labelled(rows, seed=seed, plan=plan)

    alone = [labelled([{"configuration": "alone", "seconds": 12.0 * n}], seed=n, plan=3) for n in (1, 2)]
    rows = tidy([job(1, 2.0, 4.0, 1), job(2, 4.0, 4.0, 1), job(1, 10.0, 5.0, 2), job(2, 20.0, 30.0, 2), *alone])
    ratios = summarise(rows, ("configuration",), Column("seconds", "", over="base"))
    assert {name: one.mean for (name,), one in ratios.items()} == {
        "base": 1.0,
        "own 1": (4 / 2 + 4 / 4) / 2,
        "own 2": (5 / 10 + 30 / 20) / 2,
        "alone": (12 / 6 + 24 / 12) / 2,  # by the mean of both jobs' of its seed
    }
    faster = summarise(rows, ("configuration",), Column("seconds", "", over="base", inverse=True))
    assert faster["own 1",].mean == (2 / 4 + 4 / 4) / 2


def test_what_is_divided_by_an_error_that_is_lost_in_noise_has_no_verdict():
    def job(seed, base):
        return labelled([{"configuration": "a", "relmse": 0.5}, {"configuration": "b", "relmse": base}], seed=seed)

    claim = Claim("", "relmse", "a", "b", high=1.0)
    assert judge(claim, tidy([job(1, 1.0), job(2, 1.1), job(3, 1.2)]), "box").verdict == "holds"
    lost = judge(claim, tidy([job(1, 1.0), job(2, 1.1), job(3, -0.001)]), "box")
    assert (lost.verdict, lost.low, lost.n) == ("open", None, 2)


def test_a_claim_on_a_scene_without_rows_is_not_measured():
    rows = rows_of([1.0, 2.0], "pass.a", frame=0, counted=True)
    (found,) = verdicts(Claim("", "pass.a", "a", high=1.0, scenes=("elsewhere",)), rows)
    assert (found.scene, found.verdict, found.value) == ("elsewhere", "not measured", None)


def test_a_claim_on_a_ratio_does_not_depend_on_which_is_over_which():
    rows = tidy(
        [
            labelled([{"configuration": "a", "relmse": a}, {"configuration": "b", "relmse": b}], seed=seed)
            for seed, (a, b) in enumerate(((1.0, 2.0), (3.0, 1.0), (5.0, 4.0)), 1)
        ]
    )
    one, other = (judge(Claim("", "relmse", of, over, high=1.0), rows, "box") for of, over in (("a", "b"), ("b", "a")))
    assert one.value == pytest.approx((0.5 * 3.0 * 1.25) ** (1 / 3))
    assert (one.value, one.low, one.high) == pytest.approx((1 / other.value, 1 / other.high, 1 / other.low))
    assert one.low > 0.0


def test_intervals_are_student_s():
    values = [1.02, 0.97, 1.1, 1.05]
    verdict = judge(Claim("", "value", "a", high=1.2), rows_of(values), "box")
    low, high = stats.t.interval(0.95, 3, np.mean(values), stats.sem(values))
    assert (verdict.value, verdict.low, verdict.high) == pytest.approx((np.mean(values), low, high))


@pytest.mark.parametrize(
    ("values", "bounds", "expected"),
    [
        ([1.0, 1.1, 0.9], {"high": 1.5}, "holds"),
        ([1.0, 1.1, 0.9], {"low": 0.5, "high": 1.5}, "holds"),
        ([1.0, 1.1, 0.9], {"high": 1.1}, "open"),
        ([1.0, 1.1, 0.9], {"low": 1.5}, "fails"),
        ([1.0, 1.1, 0.9], {"high": 0.5}, "fails"),
        ([1.0, 1.0], {"high": 1.0}, "holds"),
        ([1.0], {"high": 1.5}, "open"),
        ([None, None], {"high": 1.5}, "not measured"),
    ],
)
def test_verdicts_are_those_of_the_interval(values, bounds, expected):
    assert judge(Claim("", "value", "a", **bounds), rows_of(values), "box").verdict == expected


def test_what_depends_on_no_seed_is_exact_but_for_times():
    rows = tidy([labelled([{"configuration": "a", "nodes": 5, "seconds": 5.0}], seed=None)])
    assert judge(Claim("", "nodes", "a", high=6), rows, "box").verdict == "holds"
    assert judge(Claim("", "seconds", "a", high=6), rows, "box").verdict == "open"


def test_claims_are_judged_in_the_scenes_they_name():
    both = [
        labelled([{"configuration": "a", "value": v}], scene, seed)
        for scene, v in (("x", 1), ("y", 3))
        for seed in (1, 2)
    ]
    rows = tidy(both)
    assert [(one.scene, one.verdict) for one in verdicts(Claim("", "value", "a", high=2), rows)] == [
        ("x", "holds"),
        ("y", "fails"),
    ]
    named = verdicts(Claim("", "value", "a", high=2, scenes=("y", "z")), rows)
    assert [(one.scene, one.verdict) for one in named] == [("y", "fails"), ("z", "not measured")]
    assert [one.verdict for one in verdicts(Claim("", "value", "lost"), rows)] == ["not measured"]
    assert [one.verdict for one in verdicts(Claim("", "value", "a", over="lost"), rows)] == ["not measured"]


def test_a_ladder_of_one_by_n_is_met_exactly():
    ladder = [(0.01 * n, 2.0 / n) for n in (1, 2, 4, 8)]
    own = {"inside": (0.03, 0.5), "fast": (0.005, 0.7), "good": (0.05, 0.1), "slow": (0.2, 3.0)}
    measured = {**{f"{n} spp": one for n, one in zip((1, 2, 4, 8), ladder, strict=True)}, **own}
    found = []
    for seed, factor in ((1, 1.0), (2, 3.0)):  # another machine: all times three times as long
        rows = [{"configuration": k, "seconds": factor * t, "relmse": e} for k, (t, e) in measured.items()]
        found.append(labelled(rows, seed=seed))
    experiment = Experiment("", "", "", "", (), (), ladder=("1 spp", "2 spp", "4 spp", "8 spp"))
    by_name = {one.configuration: one for one in equals(experiment, tidy(found))}
    assert by_name.keys() == own.keys()
    for name in ("inside", "good"):
        time, error = own[name]
        assert by_name[name].at_time.mean == pytest.approx(error / (0.02 / time))
        assert by_name[name].at_time.error == pytest.approx(0.0, abs=1e-12)
    assert by_name["inside"].at_error.mean == pytest.approx((0.02 / 0.5) / 0.03)
    assert (by_name["good"].at_error, by_name["good"].why_no_error) == (None, "errs less than 8 spp")
    assert (by_name["fast"].at_time, by_name["fast"].why_no_time) == (None, "takes less than 1 spp")
    assert by_name["fast"].at_error.mean == pytest.approx((0.02 / 0.7) / 0.005)
    assert (by_name["slow"].why_no_time, by_name["slow"].why_no_error) == (
        "takes more than 8 spp",
        "errs more than 1 spp",
    )
    assert meet(np.array([1.0, 2.0]), np.array([1.0, -1.0]), 1.5) is None


def test_the_paper_s_rows_match_by_what_they_have():
    paper = [
        {"configuration": "a", "seconds": 2.0},
        {"scene": "x", "configuration": "b", "seconds": 8.0},
        {"seconds": 5.0},
    ]
    assert printed(paper, {"scene": "y", "configuration": "a"}, Column("seconds", "")) == 2.0
    assert printed(paper, {"scene": "y", "configuration": "b"}, Column("seconds", "")) is None
    assert printed(paper, {"scene": "x", "configuration": "b"}, Column("seconds", "", over="a")) == 4.0
    assert printed(paper, {"scene": "x", "configuration": "b"}, Column("seconds", "", over="a", inverse=True)) == 0.25
    assert printed(paper, {"level": 3}, Column("seconds", "")) is None


# ---------------------------------------------------------------------------------------------------------------------
# Pictures


def test_insets_are_where_errors_differ_the_most():
    maps = [np.full((60, 90), 0.1), np.full((60, 90), 0.1)]
    maps[1][40:50, 70:80] = 1.0
    maps[1][5:15, 10:20] = 0.8
    assert places(maps, 10) == [(70, 40), (10, 5)]
    assert places(maps[:1], 10) == []
    assert difference(np.ones((1, 1, 3)), np.full((1, 1, 3), 0.5))[0, 0] == pytest.approx(0.25 / 0.26)


def test_strips_have_the_reference_first_and_the_left_eye_only():
    rng = np.random.default_rng(1)
    images = {
        f"picture/{name}/3/{eye}": rng.random((24, 32, 3), np.float32)
        for name in ("a/b", "reference")
        for eye in ("left", "right")
    }
    (strip,) = strips([labelled([], arrays=images), labelled([], seed=2, arrays=images)])
    assert [one.name for one in strip.shown] == ["reference", "a/b"]
    assert (strip.frame, strip.eye, strip.width, strip.height) == ("3", "left", 32, 24)
    kept = Image.open(io.BytesIO(base64.b64decode(strip.shown[1].uri.partition(",")[2])))
    assert kept.size == (32, 24)
    assert strip.shown[0].difference is None and strip.shown[1].difference


def test_many_pictures_lose_quality_and_at_last_stay_out(monkeypatch):
    rng = np.random.default_rng(1)
    found = [labelled([], f"s{n}", arrays={"picture/a/0/mono": rng.random((48, 64, 3), np.float32)}) for n in range(4)]
    lossless = len(strips(found)[0].shown[0].uri)
    monkeypatch.setattr("clcache.experiments.pictures.BUDGET", 2 * lossless)
    some = strips(found)
    assert len(some[0].shown[0].uri) < lossless and QUALITIES[0] is None
    monkeypatch.setattr("clcache.experiments.pictures.BUDGET", lossless // 3)
    assert 0 < len(strips(found)) < 4 or strips(found) == []


# ---------------------------------------------------------------------------------------------------------------------
# The page


class Page(HTMLParser):
    """What a page has: all of its elements closed, addresses and texts."""

    def __init__(self, text):
        super().__init__()
        self.open, self.addresses, self.texts, self.scripts, self.handlers, self.policy = [], [], [], 0, [], ""
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        self.scripts += tag == "script"
        for name, value in attributes:
            self.addresses += [value] if name in ("src", "href", "xlink:href", "action") else []
            self.handlers += [name] if name.startswith("on") else []
        if ("http-equiv", "Content-Security-Policy") in attributes:
            self.policy = dict(attributes)["content"]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        if tag not in VOID:
            assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append(data)


def written(folder, experiment, found, **about):
    told = {"command": "clcache experiment x", "is_quick": False, "seeds": [1, 2], "wall_seconds": 3.0, **about}
    write_report(folder, experiment, found, told)
    page = Page((folder / "report.html").read_text(encoding="utf-8"))
    return page, "\n".join(text.strip() for text in page.texts)


@pytest.fixture(scope="module")
def full():
    """An experiment with everything, of hostile names, and what its jobs found."""
    rng = np.random.default_rng(3)
    ladder = ("1 spp", "4 spp")
    configurations = [
        Configuration(name, "pathtrace", {"pathtrace.depth": 3}).entry() for name in (HOSTILE, "b", *ladder)
    ]
    found = []
    for scene in (HOSTILE, "=1+2"):
        for seed in (1, 2):
            rows = [
                {"configuration": c["name"], "frame": f, "counted": f > 0, "seconds": 0.1 + 0.05 * n + 0.01 * seed * f}
                | {"relmse": 0.5 / (n + seed), "works": n > 1, "said": "well" if seed == 1 else "badly", "empty": None}
                for n, c in enumerate(configurations)
                for f in range(3)
            ]
            names = ("reference", HOSTILE, "b")
            arrays = {f"picture/{name}/2/mono": rng.random((36, 48, 3), np.float32) for name in names}
            found.append(labelled(rows, scene, seed, arrays, configurations=configurations, size=[48, 36]))
    experiment = Experiment(
        "full",
        "A paper, Fig. 1",
        f"Title {HOSTILE}",
        "About.",
        (),
        (
            Table(
                "First",
                (Column("seconds", "ms", ".1f", 1e3), Column("relmse", "relMSE", ".3f"), Column("works", "works")),
            ),
            Table("Second", (Column("said", "said"), Column("empty", "empty"), Column("absent", "absent"))),
        ),
        (
            Plot("Lines", "frame", "seconds", log="y"),
            Plot("Points", "seconds", "relmse", "points", facet="", log="xy"),
            Plot("Bars", "configuration", "relmse", "bars", facet=""),
            Plot("Grouped", "said", "seconds", "bars", by="configuration", facet=""),
            Plot("Nothing", "frame", "absent"),
        ),
        (
            Claim(f"{HOSTILE} is fast", "seconds", HOSTILE, "b", high=2.0, paper=0.5),
            Claim("lost", "relmse", "lost", low=0.0),
        ),
        "Much.",
        ({"configuration": "b", "seconds": 0.02, "relmse": 0.3}, {"configuration": HOSTILE, "seconds": 0.01}),
        ladder,
    )
    return experiment, found


@pytest.fixture(scope="module")
def report(full, tmp_path_factory):
    """Its report, and an index of that and of another one: the folder, the page and its text."""
    experiment, found = full
    folder = tmp_path_factory.mktemp("reports")
    page, text = written(folder / "full", experiment, found, note=HOSTILE)
    write_index(folder, [experiment, replace(experiment, name="never", source=HOSTILE)])
    return folder, page, text


def test_a_page_is_whole_harmless_and_needs_nothing_beside_it(report):
    folder, page, text = report
    assert all(address.startswith(("data:image/", "#")) for address in page.addresses)
    assert page.handlers == []
    assert page.scripts == 1  # its own, and none of the names
    raw = (folder / "full" / "report.html").read_text(encoding="utf-8")
    (script,) = re.findall(r"<script>(.*?)</script>", raw, re.DOTALL)
    assert "default-src 'none'" in page.policy
    assert f"'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'" in page.policy
    shown = (HOSTILE, "A paper, Fig. 1", "clcache experiment x", "a processor", "pathtrace.depth=3", "yes", "badly")
    assert all(words in text for words in shown)
    assert "Quick run" not in text
    assert "holds" in text and "not measured" in text
    assert len(raw) < 2e6
    names = {file.name for file in (folder / "full").iterdir()}
    assert {"table-1.csv", "table-2.csv", "claims.csv", "rows.csv", "plot-1a.svg", "plot-4.svg"} <= names
    assert not any(name.startswith(("plot-5", ".")) for name in names)
    assert HOSTILE not in (folder / "full" / "plot-1a.svg").read_text(encoding="utf-8")


def test_tables_have_ours_beside_the_paper_s(report):
    folder = report[0] / "full"
    lines = cells(folder / "table-1.csv")
    assert [line["configuration"] for line in lines[:4]] == [HOSTILE, "b", "1 spp", "4 spp"]
    per_seed = [1e3 * (0.15 + 0.01 * seed * 1.5) for seed in (1, 2)]  # frames 1 and 2 count
    assert float(lines[1]["ms"]) == pytest.approx(np.mean(per_seed))
    assert float(lines[1]["ms: standard error"]) == pytest.approx(stats.sem(per_seed))
    assert (lines[1]["ms: paper"], lines[1]["ms: seeds"], lines[2]["ms: paper"]) == ("20.0", "2", "")
    assert lines[4]["scene"] == "'=1+2"  # no formula
    assert len(cells(folder / "rows.csv")) == 2 * 2 * 4 * 3
    judged = cells(folder / "claims.csv")
    assert [(line["verdict"], line["seeds"]) for line in judged] == [("holds", "2")] * 2 + [("not measured", "0")]


def test_rows_of_any_kind_are_shown(tmp_path):
    rows = [
        {"case": "a NaN", "out": "refused", "error": None},
        {"case": "zero", "out": 0.5, "error": 1e-9, "fine": True},
    ]
    table = Table("Cases", (Column("out", "came out"), Column("error", "error"), Column("fine", "fine")), ("case",))
    levels = Table("Levels", (Column("nodes", "nodes", ".0f"),), ("level",))
    plot = Plot("By level", "level", "nodes", by="kind")
    experiment = Experiment("any", "own", "Any", "", (), (table, levels), (plot,))
    grown = [{"level": n, "nodes": 8**n, "kind": "octree"} for n in range(4)]
    found = [labelled(rows, "", None, kind="cases"), labelled(grown, "", None, kind="levels")]
    _, text = written(tmp_path, experiment, found, is_quick=True)
    assert "refused" in text and "512" in text and "1e-09" in text and "Quick run." in text
    assert "Scene" not in text.splitlines()  # of which there is none
    assert [line["nodes"] for line in cells(tmp_path / "table-2.csv")] == ["1.0", "8.0", "64.0", "512.0"]
    assert (tmp_path / "plot-1.svg").is_file()
    written(tmp_path / "none", experiment, [])
    assert cells(tmp_path / "none" / "rows.csv") == []


def test_results_of_several_machines_say_so(tmp_path):
    experiment = Experiment("any", "own", "Any", "", (), ())
    (labels, result), there = labelled([{"seconds": 1.0}], seed=1), labelled([{"seconds": 9.0}], seed=2)
    _, text = written(tmp_path, experiment, [(labels, result), there])
    assert "Not all from one machine." not in text and "Load" not in text
    far = replace(there[1], about=there[1].about | {"host": "there", "load": 7.25})
    _, text = written(tmp_path, experiment, [(labels, result), (there[0], far)])
    assert "Not all from one machine." in text and "7.2 to 7.2 processes" in text


def test_formulas_become_words_and_numbers_stay(tmp_path):
    write_csv(tmp_path / "x.csv", pd.DataFrame({"=head": ["=1", "@x", "-1.5", "+y", "plain", -2.5]}, dtype=object))
    assert [line["'=head"] for line in cells(tmp_path / "x.csv")] == ["'=1", "'@x", "-1.5", "'+y", "plain", "-2.5"]


def test_an_index_leads_to_reports(report):
    page = Page((report[0] / "index.html").read_text(encoding="utf-8"))
    assert page.addresses == ["full/report.html", "never/report.html"]
    assert page.scripts == 0 and "script-src 'none'" in page.policy
    assert HOSTILE in page.texts
    assert "2" in page.texts  # claims that hold


def test_a_single_value_has_no_error():
    assert math.isnan(Estimate.of([3.0]).error)
    assert Estimate.of([3.0, 5.0]) == Estimate(4.0, 1.0, 2)
