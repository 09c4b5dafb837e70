"""The function blocks parse, validate, and compute the bits of the other evaluators."""

from __future__ import annotations

import ctypes
import re
import shutil
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from bench.bench_tables import machine
from errpipe.errors import VerifyError
from errpipe.tables import ect
from errpipe.targets import iec_st, twincat_nc_table
from tests.compiled import compile_once
from tests.faults import sequences
from tests.unit.tables.made import everything, numba_stream, stimulus, ten_um_too_long
from tests.unit.targets.c.test_c_runtime import damaged, python_takes
from tests.unit.targets.st import matiec, translate

UNITS = (*iec_st.TYPES, *iec_st.FUNCTIONS, *iec_st.BLOCKS)
needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")
ROUNDINGS = {"half away": "lround", "towards zero": ""}  # the others run half to even


def room():
    return iec_st.capacity_for(machine(thermal=True))


def units():
    sizes = room()
    return [iec_st.unit(name, sizes) for name in UNITS]


class Block:
    """Exported Structured Text as a shared library."""

    def __init__(self, folder, code: str, rounding: str = "lrint", optimise: str = "-O2"):
        (folder / "st.c").write_text(code)
        flags = [optimise, "-ffp-contract=off", "-fwrapv", "-w", f"-DROUNDING={rounding}", "-shared", "-fPIC"]
        self.dll = ctypes.CDLL(str(compile_once(["gcc", *flags], [folder / "st.c"], folder / "st.so", "-lm")))

    def load(self, data: bytes) -> tuple[int, int]:
        where = ctypes.c_int32()
        return self.dll.load(data, ctypes.c_size_t(len(data)), ctypes.byref(where)), where.value

    def stream(self, table, readings, fresh, enable):
        data, cycles = ect.dumps(table), len(readings)
        deviation, correction = np.empty((2, cycles, len(table.outputs)))
        status = np.empty(cycles, dtype=np.uint32)
        arrays = (np.ascontiguousarray(readings), fresh, enable, deviation, correction, status)
        pointers = [a.ctypes.data_as(ctypes.c_void_p) for a in arrays]
        error = self.dll.stream(data, ctypes.c_size_t(len(data)), ctypes.c_size_t(cycles), *pointers)
        assert error == 0, error
        return deviation, correction, status


@pytest.fixture(scope="module")
def block(tmp_path_factory):
    return Block(tmp_path_factory.mktemp("st"), translate.by_lines(units()))


@needs_gcc
@pytest.mark.toolchain
@pytest.mark.parametrize("seed", range(25))
def test_equal_to_the_other_evaluators_to_the_bit(block, seed):
    table = everything(seed)
    case = stimulus(table, 1500, seed)
    for ours, theirs in zip(block.stream(table, *case), numba_stream(table, *case), strict=True):
        assert np.array_equal(ours, theirs)


@needs_gcc
@pytest.mark.toolchain
def test_a_machine_ten_um_too_long_is_moved_back(block):
    readings, ones = np.array([[0.0], [500.0], [1000.0]]), np.ones((3, 1), dtype=np.uint8)
    _, correction, _ = block.stream(ten_um_too_long(), readings, ones, np.ones(3, dtype=np.uint8))
    assert correction[:, 0].tolist() == [0.0, -0.005, -0.01]


@needs_gcc
@pytest.mark.toolchain
@pytest.mark.parametrize("rounding", ROUNDINGS)
def test_it_does_not_matter_how_the_compiler_rounds(tmp_path, rounding):
    other = Block(tmp_path, translate.by_lines(units()), ROUNDINGS[rounding])
    for seed in (2, 9, 17):
        table = everything(seed)
        case = stimulus(table, 500, seed)
        for ours, theirs in zip(other.stream(table, *case), numba_stream(table, *case), strict=True):
            assert np.array_equal(ours, theirs)


@needs_gcc
@pytest.mark.toolchain
def test_a_damaged_file_is_never_loaded(block):
    data = ect.dumps(everything(3))
    assert block.load(data)[0] == 0
    for count in (0, 100, 511, 600, len(data) - 1):
        assert block.load(data[:count])[0] == 3
    for at in range(0, len(data), 61):
        broken = bytearray(data)
        broken[at] ^= 4
        assert block.load(bytes(broken))[0] != 0


@pytest.mark.slow
@needs_gcc
@pytest.mark.toolchain
def test_it_refuses_what_the_other_readers_refuse_and_runs_the_rest_within_its_arrays(tmp_path):
    """Damage behind a mended checksum: what loads is run under a sanitizer that watches every index."""
    import random

    code = translate.by_lines(units()) + MAIN
    (tmp_path / "st.c").write_text(code)
    flags = ["-O1", "-g", "-ffp-contract=off", "-fwrapv", "-w", "-DROUNDING=lrint", "-fsanitize=address,bounds"]
    built = subprocess.run(["gcc", *flags, tmp_path / "st.c", "-o", tmp_path / "st", "-lm"], capture_output=True)
    if built.returncode:
        pytest.skip("no sanitizers on this machine")
    r = random.Random(11)
    sound = [ect.dumps(everything(s)) for s in range(60, 68)]
    files = []
    for k in range(1500):
        data = damaged(r, r.choice(sound))
        files.append(tmp_path / f"{k}.ect")
        files[-1].write_bytes(data)
    done = subprocess.run([tmp_path / "st", *files], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    loaded = [int(v) for v in done.stdout.split()]
    assert [bool(ok) for ok in loaded] == [python_takes(f.read_bytes()) for f in files]


SMALL = """
static FB_EctFind finder; static FB_EctWatch watcher;
int find(uint32_t name, DINT *output)
{
    finder.nName = name;
    FB_EctFind_run(&finder, &table);
    *output = finder.nOutput;
    return finder.nInput;
}
int alive(DINT heartbeat, DINT most)
{
    watcher.nHeartbeat = heartbeat;
    watcher.nMost = most;
    FB_EctWatch_run(&watcher);
    return watcher.bAlive;
}
int missed(DINT tick)
{
    block.nTick = tick;
    FB_EctCycle_run(&block, &table, &readings, &fresh, &deviation, &correction);
    return block.nMissed;
}
"""


@needs_gcc
@pytest.mark.toolchain
def test_inputs_are_found_by_name_and_missed_calls_are_seen(tmp_path):
    other = Block(tmp_path, translate.by_lines(units()) + SMALL)
    table = everything(3)
    assert other.load(ect.dumps(table))[0] == 0
    output = ctypes.c_int32()
    for number, channel in enumerate(table.inputs):
        assert other.dll.find(iec_st.name_number(channel.name), ctypes.byref(output)) == number
    for number, one in enumerate(table.outputs):
        other.dll.find(iec_st.name_number(one.name), ctypes.byref(output))
        assert output.value == number
    assert other.dll.find(iec_st.name_number("nobody"), ctypes.byref(output)) == -1 == output.value
    assert [other.dll.alive(beat, 2) for beat in (1, 2, 2, 2, 2, 3)] == [1, 1, 1, 1, 0, 1]
    assert [other.dll.missed(tick) for tick in (5, 6, 7, 10, 11, 0, 20)] == [0, 0, 0, 2, 2, 2, 2]


STORE = """
static FB_EctStore keeper; static ECT_FILE kept; static DINT given, good;
int keep(const uint8_t *data, size_t size, int news, uint32_t only)
{
    __builtin_memcpy(file, data, size);
    given = (DINT)size;
    keeper.bNew = news;
    keeper.nOnly = only;
    FB_EctStore_run(&keeper, &file, &given, &kept, &good, &first, &second);
    return keeper.nError;
}
uint32_t running(void)
{
    return keeper.nActive == 1 ? first.nName : keeper.nActive == 2 ? second.nName : 0;
}
void power_loss(void) /* RETAIN is all that stays */
{
    __builtin_memset(&keeper, 0, sizeof keeper);
    __builtin_memset(&first, 0, sizeof first);
    __builtin_memset(&second, 0, sizeof second);
    __builtin_memset(file, 0, sizeof file);
}
void spoil(size_t at) { kept[at] ^= 4; }
"""


@needs_gcc
@pytest.mark.toolchain
@pytest.mark.parametrize("compiled_by", ["translation", "MATIEC"])
def test_the_last_valid_table_is_kept_after_a_loss_of_power(tmp_path, compiled_by):
    if compiled_by == "MATIEC":
        if matiec.compiler() is None:
            pytest.skip("no iec2c: set IEC2C to a MATIEC that was built")
        plc = ctypes.CDLL(str(matiec.build(tmp_path, units())))
        plc.power_loss()
    else:
        plc = Block(tmp_path, translate.by_lines(units()) + STORE).dll
    plc.running.restype = ctypes.c_uint32
    own, other, foreign = (ect.dumps(sequences.table(n)) for n in (0, 1, 2))
    fewer = ect.dumps(sequences.table(1).model_copy(update={"outputs": sequences.table(1).outputs[:1]}))
    broken = bytes([*foreign[:700], foreign[700] ^ 1, *foreign[701:]])

    def name(data):
        return int.from_bytes(data[20:24], "little")

    def keep(data, news=0, only=0):
        return plc.keep(data, ctypes.c_size_t(len(data)), news, ctypes.c_uint32(only))

    assert keep(own) == 0 and plc.running() == name(own), "the program's table, nothing kept"
    assert keep(other, 1) == 0 and plc.running() == name(other), "a download"
    for data, only, why in ((broken, 0, 5), (fewer, 0, 101), (foreign, name(other), 100)):
        assert keep(data, 0) in (0, 5, 101, 100)
        assert keep(data, 1, only) == why and plc.running() == name(other)
    plc.power_loss()
    keep(own)
    assert plc.running() == name(other), "the last good one, not the program's nor one that was refused"
    plc.power_loss()
    plc.spoil(ctypes.c_size_t(900))
    assert keep(own) == 0 and plc.running() == name(own), "RETAIN memory was damaged"
    plc.power_loss()
    keep(own, only=name(own))
    assert plc.running() == name(own)
    wide, free = (ect.dumps(sequences.with_magnitude(sequences.table(1), most)) for most in (10000.5, None))
    jumps, fast = (ect.dumps(sequences.with_slew(sequences.table(1), most)) for most in (None, 10000.5))
    for data in (wide, free, jumps, fast):
        keep(own)
        assert keep(data, 1) == 102 and plc.running() == name(own), "a correction without a limit, of a table not named"
    keep(own)
    assert keep(free, 1, name(free)) == 0 and plc.running() == name(free), "the site named it"


def test_plain_structured_text_has_no_global_variables():
    """MATIEC refuses them outside a resource; the bytes come from a function block."""
    files = iec_st.IecSt.write(ten_um_too_long())
    assert "VAR_GLOBAL" not in files["ect.st"] and "FUNCTION_BLOCK FB_EctData" in files["ect.st"]


MAIN = """
#include <stdio.h>
int main(int argc, char **argv)
{
    static uint8_t data[1 << 20];
    int n, k, i;
    for (n = 1; n < argc; n++) {
        FILE *f = fopen(argv[n], "rb");
        size_t size = fread(data, 1, sizeof data, f);
        DINT where;
        int error = load(data, size, &where);
        fclose(f);
        __builtin_memset(&block, 0, sizeof block);
        for (k = 0; k < 4; k++) {
            for (i = 0; i < table.nInputs && error == 0; i++) {
                readings[i] = k % 2 ? table.afInLow[i] : table.afInHigh[i];
                fresh[i] = 1;
            }
            block.bEnable = 1;
            FB_EctCycle_run(&block, &table, &readings, &fresh, &deviation, &correction);
        }
        printf("%d ", error == 0);
    }
    return 0;
}
"""


@pytest.mark.slow
@needs_gcc
def test_blark_parses_it_and_its_tree_computes_the_same(tmp_path):
    pytest.importorskip("blark", reason="blark is not installed")
    other = Block(tmp_path, translate.by_tree(units()))
    for seed in range(30, 45):
        table = everything(seed)
        case = stimulus(table, 2000, seed)
        for ours, theirs in zip(other.stream(table, *case), numba_stream(table, *case), strict=True):
            assert np.array_equal(ours, theirs)


@pytest.mark.parametrize("name", UNITS)
def test_tree_sitter_finds_no_error(name):
    sitter = pytest.importorskip("tree_sitter")
    language = pytest.importorskip("tree_sitter_iec61131_3_st")
    parser = sitter.Parser(sitter.Language(language.language()))
    tree = parser.parse(iec_st.unit(name, room()).encode())
    assert not tree.root_node.has_error


@pytest.mark.parametrize("name", UNITS)
def test_only_constructs_that_every_compiler_takes(name):
    text = iec_st.unit(name, room())
    code = re.sub(r"\(\*.*?\*\)", "", text, flags=re.S)
    assert text.count("(*") == text.count("*)") and "//" not in text and "\t" not in text
    assert "__" not in code and not re.search(r"_\s|\b_", code)
    reals = re.sub(r"\d\.\d+E-?\d+", "", re.sub(r"16#\w+", "", code))
    assert not re.search(r"\d+[eE]", reals), "a real without a point"
    assert not re.search(r"\b(TRUNC|AND_THEN|OR_ELSE|RETURN|REPEAT|CASE|POINTER|REFERENCE)\b", code)
    assert not re.search(r"ARRAY \[[^\]]*[A-Za-z]", code), "bounds are literal numbers"
    assert all(re.fullmatch(r"FOR \w := \d+ TO \d+ DO", f.strip()) for f in re.findall(r"^ *FOR .*$", code, re.M))
    assert "NOT (" not in code and "@" not in text and text.isascii()


def test_every_real_literal_is_the_constant_it_stands_for():
    """Digits shortened by hand would change bits: all constants of exp and power are those of the arithmetic."""
    from errpipe.kernels import arithmetic as a

    text = iec_st.unit("EctExp", room()) + iec_st.unit("EctPower", room())
    names = {float(v) for v in re.findall(r"\d+\.\d+(?:E-?\d+)?", text)}
    assert {*a.EXP, a.LOG2_E, a.LN2_HIGH, a.LN2_LOW, a.SQRT2, a.SMALLEST_BASE, a.LARGEST_EXPONENT} <= names
    assert [1.0 / k for k in range(21, 0, -2)] == list(a.LN)


def test_twincat_files_are_xml_with_the_same_text():
    files = iec_st.IecSt.write(ten_um_too_long())
    for name in UNITS:
        file = files[f"{name}.{'TcDUT' if name in iec_st.TYPES else 'TcPOU'}"]
        root = ElementTree.fromstring(file.encode())
        assert root[0].get("Name") == name and re.fullmatch(r"\{[0-9a-f-]{36}\}", root[0].get("Id"))
        texts = "".join(e.text for e in root.iter() if e.tag in ("Declaration", "ST"))
        whole = iec_st.unit(name, iec_st.capacity_for(ten_um_too_long()))
        assert whole.startswith(texts) and len(whole) - len(texts) < 25


@pytest.mark.slow
def test_blark_reads_the_twincat_files(tmp_path):
    blark = pytest.importorskip("blark.parse")
    files = iec_st.IecSt.write(ten_um_too_long())
    for name in ("EctMove.TcPOU", "EctClosing.TcPOU", "ECT_TABLE.TcDUT"):
        (tmp_path / name).write_text(files[name])
        assert all(result.exception is None for result in blark.parse(tmp_path / name))


def test_the_library_project_lists_every_type_and_block_and_its_version(tmp_path):
    solution = pytest.importorskip("blark.solution")
    files = iec_st.IecSt.write(ten_um_too_long())
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    project = solution.TwincatPlcProject.from_filename(tmp_path / "errpipe.plcproj")
    assert {Path(str(s.saved_path)).name.split(".")[0] for s in project.sources} == set(UNITS)
    root = ElementTree.fromstring(files["errpipe.plcproj"].encode())
    by_name = {e.tag.split("}")[1]: e.text for e in root[0]}
    assert by_name["ProjectVersion"] == iec_st.LIBRARY_VERSION and by_name["Title"] == "errpipe"
    assert f'version="{iec_st.LIBRARY_VERSION}"' in files["ect.plcopen.xml"]


def test_the_example_takes_no_reading_for_that_of_another_table():
    """A temperature that the program does not bring stood where the table before had X: it was X, in degC."""
    example = iec_st.IecSt.write(ten_um_too_long())["example_twincat.st"]
    exchanged = example.partition("IF fbStore.nActive <> nActive THEN")[2].partition("fbFind(")[0]
    assert "abFresh := abNone;" in exchanged and example.count("abNone") == 2  # declared, and never written


@pytest.mark.slow
def test_the_example_and_the_calls_of_nc_tables_parse():
    parse = pytest.importorskip("blark.parse").parse_source_code
    example = iec_st.IecSt.write(ten_um_too_long())["example_twincat.st"]
    nc = twincat_nc_table.TwincatNcTable.write(ten_um_too_long())
    for text in (example, *nc.values()):
        assert parse(text).exception is None
        assert parse(text.replace("END_IF;", "END_IIF;").replace("Enable :=", "Enable ::=")).exception is not None
    for word in ("REFERENCE TO ECT_TABLE", "VAR_GLOBAL RETAIN", "AXIS_REF", "FB_EctStore", "FB_EctWatch", "FB_EctFind"):
        assert word in example
    calls = re.findall(r"pTable := ADR\((\w+)\), TableSize := SIZEOF\((\w+)\)", nc["GVL_Compensation_X.st"])
    assert calls == [("aCompensationXUp",) * 2, ("aCompensationXDown",) * 2]


def test_plcopen_xml_is_valid():
    """Against the TC6 2.01 schema, which comes with the package plcrex (pip install --no-deps plcrex)."""
    from importlib.util import find_spec

    xmlschema = pytest.importorskip("xmlschema")
    spec = find_spec("plcrex")
    if spec is None:
        pytest.skip("plcrex, which brings the schema, is not installed")
    schema = xmlschema.XMLSchema(Path(spec.origin).parent / "data" / "tc6" / "tc6_xml_v201.xsd")
    text = iec_st.IecSt.write(ten_um_too_long())["ect.plcopen.xml"]
    schema.validate(text)
    assert not schema.is_valid(text.replace("<LREAL/>", "<LREALISH/>", 1))


def test_plcopen_xml_holds_all_units_and_their_text():
    root = ElementTree.fromstring(iec_st.IecSt.write(ten_um_too_long())["ect.plcopen.xml"].encode())
    ns = {"p": "http://www.plcopen.org/xml/tc6_0201", "x": "http://www.w3.org/1999/xhtml"}
    assert [e.get("name") for e in root.findall(".//p:dataType", ns)] == list(iec_st.TYPES)
    pous = root.findall(".//p:pou", ns)
    assert [e.get("name") for e in pous] == [*iec_st.FUNCTIONS, *iec_st.BLOCKS]
    sizes = iec_st.capacity_for(ten_um_too_long())
    for pou in pous:
        assert pou.find(".//x:p", ns).text == iec_st.split(iec_st.unit(pou.get("name"), sizes))[1]


def test_what_is_read_back_is_the_table():
    table = machine(thermal=True)
    files = iec_st.IecSt.write(table)
    assert iec_st.IecSt.read_back(files).table == table
    other = files | {"GVL_EctData.TcGVL": files["GVL_EctData.TcGVL"].replace("69, 67", "69, 68")}
    with pytest.raises(VerifyError, match="one and the same table"):
        iec_st.IecSt.read_back(other)
    with pytest.raises(VerifyError, match=r"FB_EctCycle.TcPOU: is missing or was changed"):
        iec_st.IecSt.read_back(files | {"FB_EctCycle.TcPOU": files["FB_EctCycle.TcPOU"].replace("-af", "af")})


def test_names_in_the_table_cannot_end_the_comment():
    table = ten_um_too_long(title="x *) evil := 1; (* y")
    text = iec_st.IecSt.write(table)["GVL_EctData.TcGVL"]
    assert text.count("*)") == 1 and text.count("(*") == 1
