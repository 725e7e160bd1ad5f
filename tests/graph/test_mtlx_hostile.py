"""MaterialX documents that are wrong, or made to do harm: one clear line each, and never a crash, a hang or a file read.

The package that parses them is C++ and could take the process with it, so each runs in a child process with little memory.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import clcache

ROOT = Path(clcache.__file__).parents[1]
READ_ALL = """
import json, resource, sys
from pathlib import Path
from clcache.errors import SceneError
from clcache.graph import load
resource.setrlimit(resource.RLIMIT_AS, (4 << 30, 4 << 30))
for path in sorted(Path(sys.argv[1]).glob("*.mtlx")):
    print(json.dumps(path.stem), end=" ", flush=True)
    try:
        print(json.dumps(["read", load(path).cost]), flush=True)
    except SceneError as error:
        print(json.dumps(["error", str(error)]), flush=True)
"""
OUT = '<output name="out" type="color3" nodename="a" />'
ADD = '<add name="a" type="color3"><input name="in1" type="color3" {} /></add>' + OUT
ME = (
    '<nodedef name="ND_me" node="me"><input name="in" type="color3" value="1,1,1" />'
    '<output name="out" type="color3" /></nodedef>'
)


def document(body, root='version="1.39"'):
    return f'<?xml version="1.0"?>\n<materialx {root}>\n{body}\n</materialx>\n'


def graph(body):
    return document(f'<nodegraph name="g">\n{body}\n</nodegraph>')


def image(file):
    return graph(f'<image name="a" type="color3"><input name="file" type="filename" value="{file}" /></image>{OUT}')


def made(nodes, type_name):
    """A graph whose colour is made from the node r, of a type."""
    return graph(
        f'{nodes}<convert name="a" type="color3"><input name="in" type="{type_name}" nodename="r" /></convert>{OUT}'
    )


def turned_by(unit):
    return (
        '<rotate2d name="r" type="vector2">'
        f'<input name="amount" type="float" value="1" unit="{unit}" unittype="angle" /></rotate2d>'
    )


def material(shader, shaders=""):
    connection = f'<input name="surfaceshader" type="surfaceshader" {shader} />'
    return document(f'{shaders}<surfacematerial name="M" type="material">{connection}</surfacematerial>')


def dots(count):
    """Nodes c0, a constant, and c1 …, each of which passes the one before on."""
    dot = '<dot name="c{}" type="color3"><input name="in" type="color3" nodename="c{}" /></dot>'
    return chain(count, '<constant name="c0" type="color3" />', dot)


def chain(count, first, rest):
    return first + "".join(rest.format(i, i - 1) for i in range(1, count))


def bomb(levels):
    """Kinds of nodes each of which uses the kind before it twice."""
    text = ""
    for i in range(levels):
        one = f'<d{i - 1} name="{{}}" type="color3"><input name="in" type="color3" {{}} /></d{i - 1}>'
        inside = one.format("b", 'interfacename="in"') + one.format("a", 'nodename="b"') + OUT
        if i == 0:
            inside = ADD.format('interfacename="in"')
        text += ME.replace("ND_me", f"ND_{i}").replace('"me"', f'"d{i}"')
        text += f'<nodegraph name="NG_{i}" nodedef="ND_{i}">{inside}</nodegraph>'
    place = '<noise2d name="c" type="color3" />'
    last = f'<d{levels - 1} name="a" type="color3"><input name="in" type="color3" nodename="c" /></d{levels - 1}>'
    return document(f'{text}<nodegraph name="g">{place}{last}{OUT}</nodegraph>')


DOCUMENTS = {
    # No MaterialX.
    "empty": ("", ":1: no element found"),
    "text": ("hello", ":1: syntax error"),
    "bytes": (bytes(range(256)), ":1: not well-formed"),
    "cut": ('<materialx version="1.39">\n<nodegraph name="g">', ":2: no element found"),
    "another_root": ("<html />", ":1: html; expected materialx"),
    "utf16": (document("").encode("utf-16"), "byte 0 is not UTF-8 text"),
    "instruction": ('<?php echo ?><materialx version="1.39" />', ":1: a processing instruction"),
    # Other files, entities.
    "laughs": (
        '<!DOCTYPE l [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;">]><materialx version="1.39"><nodegraph name="&b;" /></materialx>',
        ":1: a document type declaration",
    ),
    "entity": (
        '<!DOCTYPE l [<!ENTITY a SYSTEM "file:///etc/passwd">]><materialx version="1.39">&a;</materialx>',
        ":1: a document type declaration",
    ),
    "include": (document('<xi:include href="/etc/passwd" />'), ":3: an inclusion of another file"),
    "outside": (image("../../etc/passwd"), ":4: image a: '../../etc/passwd' leaves the scene's folder"),
    "absolute": (image("/etc/passwd"), ":4: image a: '/etc/passwd' leaves the scene's folder"),
    "url": (image("http://a/b.png"), ":4: image a: 'http://a/b.png' is a URL"),
    "no_such_file": (image("nothing.png"), ":4: image a: 'nothing.png': no such file"),
    "tokens": (image("a.&lt;UDIM&gt;.png"), ":4: image a: file 'a.<UDIM>.png' has a token in it"),
    "prefix": (
        image("etc/passwd").replace('name="g"', 'name="g" fileprefix="../../../"'),
        ":4: image a: '../../../etc/passwd' leaves the scene's folder",
    ),
    "source_code": (
        document(
            ME
            + '<implementation name="I" nodedef="ND_me" file="/etc/passwd" /><nodegraph name="g"><me name="a" type="color3" />'
            + OUT
            + "</nodegraph>"
        ),
        ":3: me a: nodes of the kind me are not supported",
    ),
    # Too much.
    "deep": (document("<a name='a'>" * 50_000 + "</a>" * 50_000), ":3: 17 elements inside each other"),
    "many": (document('<constant type="float" />' * 9000), ":3: more than 8192 elements"),
    "long_value": (graph(ADD.format(f'value="{"9" * 5000}"')), ":4: input in1: value of 5000 characters"),
    "chain": (graph(dots(1500) + '<output name="out" type="color3" nodename="c1499" />'), 0),
    "chain_to_an_error": (
        graph(dots(1500).replace('<constant name="c0"', '<geomcolor name="c0"') + ADD.format('nodename="c1499"')),
        ":4: geomcolor c0: nodes of the kind geomcolor are not supported",
    ),
    "doubling": (
        graph(
            chain(
                60,
                '<noise2d name="c0" type="color3" />',
                '<add name="c{0}" type="color3"><input name="in1" type="color3" nodename="c{1}" />'
                '<input name="in2" type="color3" nodename="c{1}" /></add>',
            )
            + '<output name="out" type="color3" nodename="c59" />'
        ),
        range(60, 70),
    ),
    "bomb": (bomb(40), ": the document expands to more than 10,000 nodes"),
    "outputs_times_nodes": (
        graph(dots(2000) + "".join(f'<output name="o{i}" type="color3" nodename="c1999" />' for i in range(2000))),
        ": 2000 outputs and 3999 connections; expected fewer",
    ),
    "inheritance": (
        document(chain(200, ME.replace("ND_me", "d0"), '<nodedef name="d{}" node="me" inherit="d{}" />')),
        ":3: nodedef d101: more than 100 elements inherit others",
    ),
    "collections": (
        document('<collection name="c" includecollection="d" />'),
        ":3: collection c: a collection of collections",
    ),
    "octaves": (
        graph(
            '<fractal3d name="a" type="color3"><input name="octaves" type="integer" value="2000000000" /></fractal3d>'
            + OUT
        ),
        2,
    ),
    # Cycles.
    "node_of_itself": (graph(ADD.format('nodename="a"')), ":4: Cycle in upstream path"),
    "graph_of_itself": (graph(ADD.format('nodegraph="g" output="out"')), ":4: Cycle in upstream path"),
    "graph_as_a_node": (graph(ADD.format('nodename="g" output="out"')), ":4: add a: its value depends on itself"),
    "input_of_itself": (
        graph('<input name="x" type="color3" interfacename="x" />' + ADD.format('interfacename="x"')),
        ":4: Interface name not found",
    ),
    "input_from_its_graph": (
        graph('<input name="x" type="color3" nodegraph="g" output="out" />' + ADD.format('interfacename="x"')),
        ":4: Cycle in upstream path",
    ),
    "output_of_itself": (graph('<output name="out" type="color3" output="out" />'), ":4: Invalid port connection"),
    "kind_of_itself": (
        document(
            ME
            + '<nodegraph name="NG_me" nodedef="ND_me">'
            + '<me name="a" type="color3"><input name="in" type="color3" interfacename="in" /></me>'
            + OUT
            + '</nodegraph><nodegraph name="g"><me name="a" type="color3" />'
            + OUT
            + "</nodegraph>"
        ),
        ":3: me a: its kind is implemented by itself",
    ),
    "definition_of_itself": (
        document(ME.replace("node=", 'inherit="ND_me" node=')),
        ":3: Cycle in element inheritance chain",
    ),
    "used_definition_of_itself": (
        document(
            ME.replace("node=", 'inherit="ND_me" node=')
            + f'<nodegraph name="g"><me name="a" type="color3" />{OUT}</nodegraph>'
        ),
        "ycle",
    ),
    "graph_inherits_itself": (document('<nodegraph name="g" inherit="g" />'), ":3: Cycle in element inheritance chain"),
    "shader_of_itself": (
        material(
            'nodename="d"',
            '<dot name="d" type="surfaceshader"><input name="in" type="surfaceshader" nodename="d" /></dot>',
        ),
        ":3: dot d: connects no surface shader that is supported",
    ),
    # Values.
    **{
        f"value_{i}": (
            graph(ADD.format(f'value="{value}"')),
            f":4: input in1: value '{value}'; expected 3 finite numbers",
        )
        for i, value in enumerate(
            ["1e999,0,0", "nan,0,0", "inf,0,0", "1e39,0,0", "1,2", "1,2,3,4", "a,b,c", "1;2;3", "1,2,", " , , "]
        )
    },
    "no_value": (graph(ADD.format('value=""')), ":4: Invalid value, at input in1"),
    "boolean": (
        graph('<constant name="a" type="boolean"><input name="value" type="boolean" value="perhaps" /></constant>'),
        ":4: input value: value 'perhaps'",
    ),
    "integer": (
        graph('<constant name="a" type="integer"><input name="value" type="integer" value="5000000000" /></constant>'),
        ":4: input value: value '5000000000'; expected a whole number of 32 bits",
    ),
    "unit_of_a_picture": (
        image("p.png").replace("/></image>", 'unit="inch" unittype="distance" /></image>'),
        ":4: input file: its picture holds numbers in inch; expected no unit",
    ),
    "fault_of_one_of_a_name": (
        document(
            '<nodegraph name="f">\n<position name="a" type="vector3" />\n</nodegraph>\n<nodegraph name="g">\n'
            + ADD.format('nodename="b"')
            + "\n</nodegraph>"
        ),
        ":7: Invalid port connection, at input in1",
    ),
    "index": (
        made(
            '<extract name="r" type="float"><input name="in" type="color3" value="1,1,1" />'
            '<input name="index" type="integer" value="9" /></extract>',
            "float",
        ),
        ":4: extract r: index 9; expected 0 to 2",
    ),
    "unit": (made(turned_by("gon"), "vector2"), ":4: Unit definition does not exist in document, at input amount"),
    "own_unit": (
        made(turned_by("gon").replace('"angle"', '"turns"'), "vector2").replace(
            '<nodegraph name="g">',
            '<unittypedef name="turns" /><unitdef name="U" unittype="turns"><unit name="gon" scale="0.9" /></unitdef>'
            '<nodegraph name="g">',
        ),
        ":4: input amount: unit gon is not supported; expected one of nanometer, ",
    ),
    # Names and connections.
    "same_name": (
        graph('<add name="a" type="color3" />\n<add name="a" type="color3" />' + OUT),
        ":5: add a: the same name as on line 4",
    ),
    "bad_name": (graph('<add name="a/b" type="color3" />'), ":4: add a/b: expected a name"),
    "lines_in_a_name": (graph('<add name="&#10;a" type="color3" />'), ":4: add ?a: expected a name"),
    "no_such_node": (graph(ADD.format('nodename="b"')), ":4: Invalid port connection, at input in1"),
    "no_such_graph": (
        graph(ADD.format('nodegraph="b"')),
        ":4: input in1: is connected to b, which is no nodegraph of the document",
    ),
    "no_such_kind": (graph('<banana name="a" type="color3" />' + OUT), ":4: banana a: no kind of node has this name"),
    "no_such_type": (graph('<add name="a" type="banana" />' + OUT), ":4: "),
    "wrong_type": (graph('<position name="a" type="vector3" />' + OUT), ":4: Mismatched types"),
    "matrices": (
        made(
            '<add name="m" type="matrix33" />'
            '<transformmatrix name="r" type="vector3"><input name="mat" type="matrix33" nodename="m" /></transformmatrix>',
            "vector3",
        ),
        ":4: add m: computes with matrices",
    ),
    "world": (
        made(
            '<position name="r" type="vector3"><input name="space" type="string" value="world" /></position>', "vector3"
        ),
        ":4: position r: reads the position in 'world' space",
    ),
    "second_uv": (
        made('<texcoord name="r" type="vector2"><input name="index" type="integer" value="1" /></texcoord>', "vector2"),
        ":4: texcoord r: reads a second set of texture coordinates",
    ),
    # Versions and materials.
    "version": (document("", 'version="banana"'), "Unsupported document version"),
    "future": (document("", 'version="99.1"'), "Future document version"),
    "nothing": (document(""), "has no surface material"),
    "no_shader": (
        document('<surfacematerial name="M" type="material" />'),
        ":3: surfacematerial M: connects no surface shader that is supported",
    ),
    "graph_without_outputs": (material('nodegraph="g"', '<nodegraph name="g" />'), ":3: "),
    **{
        f"own_shader_with_{kind}": (
            material(
                'nodename="s"',
                f'<nodedef name="ND_my" node="standard_surface"><input name="transmission" type="{kind}" />'
                '<output name="out" type="surfaceshader" /></nodedef>'
                '<standard_surface name="s" type="surfaceshader" nodedef="ND_my" />',
            ),
            ":3: standard_surface s: nodes of the kind standard_surface are not supported",
        )
        for kind in ("string", "filename", "matrix33", "color3")
    },
    "volume": (document('<volumematerial name="M" type="material" />'), ":3: volumematerial M: not supported"),
    "unlit": (
        document('<surface_unlit name="s" type="surfaceshader" />'),
        ":3: surface_unlit s: not supported as a surface shader",
    ),
}


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """What became of each document, by name. Ends at the first that takes the process with it."""
    folder = tmp_path_factory.mktemp("hostile")
    for name, (text, _) in DOCUMENTS.items():
        (folder / f"{name}.mtlx").write_bytes(text if isinstance(text, bytes) else text.encode())
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    child = subprocess.run(
        [sys.executable, "-c", READ_ALL, str(folder)], capture_output=True, text=True, timeout=300, env=environment
    )
    lines = [line.partition(" ") for line in child.stdout.splitlines()]
    return {json.loads(name): json.loads(result) if result else ["ended", child.stderr] for name, _, result in lines}


@pytest.mark.parametrize("name", DOCUMENTS)
def test_hostile_document(results, name):
    expected = DOCUMENTS[name][1]
    found, what = results.get(name, ["not reached", ""])
    if isinstance(expected, str):
        assert found == "error" and expected in what and f"{name}.mtlx" in what and "\n" not in what
    else:
        assert found == "read" and what in (expected if isinstance(expected, range) else [expected])
