"""What is taken for arrays, labels, colours, names and options, and how the rest is refused."""

import copy
import os
import typing
from pathlib import Path

import numpy as np
import pytest
from test_segment import dumbbell

import nystrom_stream


@pytest.fixture(scope="module")
def mesh():
    vertices, faces = dumbbell(20)
    return vertices.astype(np.float32), faces


@pytest.fixture(scope="module")
def cut(mesh):
    return nystrom_stream.segment(*mesh, 3)


def packed(values, kind):
    """`values` as a field of packed records, whose stride is no multiple of its items."""
    records = np.zeros(len(values), [("before", "u1"), ("field", kind, np.shape(values)[1:])])
    records["field"] = values
    return records["field"]


def unaligned(values):
    """`values` one after the other, but at an odd address."""
    values = np.ascontiguousarray(values)
    return np.frombuffer(b"x" + values.tobytes(), values.dtype, offset=1).reshape(values.shape)


def test_fields_of_packed_records_are_taken_as_they_are(mesh, cut):
    # Regression: strides were counted in whole items, so that another mesh was cut in silence.
    vertices, faces = mesh
    records = np.zeros(len(vertices), [("xyz", "<f4", 3), ("rgb", "u1", 3)])
    records["xyz"] = vertices
    listed = np.zeros(len(faces), [("n", "u1"), ("at", "<i4", 3)])
    listed["at"] = faces
    for given in [(records["xyz"], faces), (vertices, listed["at"]), (packed(vertices, "<f8"), packed(faces, "<i8")),
                  (unaligned(vertices), unaligned(faces)), (vertices.astype(">f4"), faces.astype(">u4"))]:
        assert (nystrom_stream.segment(*given, 3).labels == cut.labels).all()
    area = nystrom_stream.measure(records["xyz"], faces)["area"]
    assert area == nystrom_stream.measure(vertices, faces)["area"]
    # A triangle and a quadrangle: polygons of different lengths.
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0]])
    assert nystrom_stream.measure(packed(square, "<f8"), [[0, 1, 2, 3], [1, 4, 2]])["area"] == 1.5
    native = nystrom_stream._meshes.as_mesh(mesh)
    for odd in (packed(cut.labels, "<u4"), unaligned(cut.labels), np.repeat(cut.labels, 2)[::2]):
        assert nystrom_stream.evaluate(cut, odd)["rand"] == 0
        assert (nystrom_stream._edits.as_hints(odd, native) == cut.labels).all()
        assert (nystrom_stream.picture(mesh, odd, colours=packed(cut.colours, "u1"), size=(64, 48)) == cut.picture(size=(64, 48))).all()


def test_colours_are_whole_or_real(cut):
    # Regression: real ones were black, others wrapped around, and too few were accepted.
    colours = np.array([[255, 0, 0], [0, 255, 0], [0, 0, 255]])
    expected = cut.picture(colours=colours, size=(64, 48))
    for same in (colours.tolist(), colours / 255, (colours / 255).astype(np.float32), colours.astype(np.uint8)):
        assert (cut.picture(colours=same, size=(64, 48)) == expected).all()
    for wrong in (colours + 1, colours - 1, colours.astype(float), colours * np.nan):
        with pytest.raises(ValueError, match="colours: out of range; give integers from 0 to 255, or floats"):
            cut.picture(colours=wrong)
    with pytest.raises(ValueError, match="colours: 2 for 3 parts; give one per part"):
        cut.picture(colours=colours[:2])
    with pytest.raises((TypeError, ValueError), match="colours: "):
        cut.picture(colours=["#ff0000"] * 3)


def test_a_palette_changes_no_number_of_parts(mesh, cut):
    # Regression: a cut had as many parts as it was given colours, lists were no colours of a trimesh, and a transfer shared its own.
    carried = nystrom_stream.transfer_labels(cut, mesh)
    before = cut.colours.copy()
    carried.colours[:] = 0
    assert (cut.colours == before).all()
    carried.colours = [[1.0, 0.5, 0.0]] * 20
    assert carried.colours.tolist() == [[255, 128, 0]] * 3
    coloured = copy.copy(cut)
    coloured.colours = np.arange(60).reshape(20, 3)
    assert coloured.n_parts == 3 and (coloured.colours == np.arange(9).reshape(3, 3)).all()
    assert repr(coloured) == repr(cut) and len(coloured.measure()) == 3
    with pytest.raises(ValueError, match="colours: 2 for 3 parts; give one per part"):
        coloured.colours = before[:2]
    # Regression: a palette of bytes was not copied, so that changing it changed the cut.
    palette = np.full((3, 3), 7, np.uint8)
    coloured.colours = palette
    palette[:] = 200
    assert (coloured.colours == 7).all()


def test_whole_numbers_of_parts_of_any_type(mesh):
    # Regression: with an option of the embedding they were no JSON, or no integer.
    expected = nystrom_stream.segment(*mesh, 3, cluster="kmeans", sigma=0.5).labels
    for parts in (np.int64(3), 3.0, np.float32(3)):
        assert (nystrom_stream.segment(*mesh, parts, cluster="kmeans", sigma=0.5).labels == expected).all()
    embedding = nystrom_stream.segment(*mesh, 3, cluster="kmeans", normalise="degree").report["options"]["embedding"]
    assert embedding["width"] == {"rule": "mean", "value": 1.0} and embedding["unit_rows"] and embedding["dimensions"] == 3


def test_a_number_in_the_place_of_faces_is_told_to_be_parts(mesh):
    # Regression: "object of type 'int' has no len()".
    for given in ("mesh.ply", mesh, Path("mesh.ply")):
        with pytest.raises(TypeError, match="faces: 6 is a number; write parts=6"):
            nystrom_stream.segment(given, 6)
    with pytest.raises(TypeError, match="faces: 6 is a number"):
        nystrom_stream.sequence(mesh, 6)


def test_faces_without_a_label(mesh, cut):
    # Regression: negative numbers were refused, though they are what says so in an array.
    labels = cut.labels.astype(np.int64)
    some = np.where(np.arange(len(labels)) % 7, labels, -1)
    for given in (some, some.astype(np.int16), np.where(some < 0, 2**32 - 1, some), np.where(some < 0, 2**32 - 1, some).astype(np.uint32)):
        carried = nystrom_stream.transfer_labels(mesh, mesh, given)
        assert set(np.unique(carried.labels)) == {0, 1, 2} and (carried.labels == labels).mean() > 0.98
        assert nystrom_stream.picture(mesh, given, size=(64, 48)).shape == (48, 64, 4)
        assert nystrom_stream.picture(mesh, given, colours=cut.colours, size=(64, 48)).shape == (48, 64, 4)
    with pytest.raises(ValueError, match="labels: -1 is negative"):
        nystrom_stream.evaluate(some, labels, mesh=mesh)
    with pytest.raises(ValueError, match="exceeds 32 bits"):
        nystrom_stream.transfer_labels(mesh, mesh, np.where(some < 0, 2**32, some))


def test_names_are_looked_at_before_the_mesh_is_cut(mesh, tmp_path):
    # Regression: a table that is not there was told after the whole cut, which was lost.
    def never(*_):
        raise AssertionError("it was cut")

    table = tmp_path / "names.tsv"
    table.write_text("part\tname\n3\tright ball\n")
    for names, wrong in [(tmp_path / "none.tsv", FileNotFoundError), ({0: 7}, ValueError), (["two\nlines"], ValueError),
                         ({-1: "a"}, ValueError), ({"a": "b"}, TypeError), ({3: "a"}, ValueError), (table, ValueError)]:
        with pytest.raises(wrong, match="names|none.tsv"):
            nystrom_stream.segment(*mesh, 3, names=names, progress=never)
    # Regression: a set gave its names in an order that changed from run to run.
    with pytest.raises(TypeError, match="names: a set has no order"):
        nystrom_stream.segment(*mesh, 3, names={"a", "b"}, progress=never)
    # Hints may leave another number of parts.
    hints = np.zeros(len(mesh[1]), int)
    with pytest.raises(ValueError, match="names: there is no part 9; the 3 parts"):
        nystrom_stream.segment(*mesh, 3, hints=hints, names={9: "a"})
    assert nystrom_stream.segment(*mesh, 3, names=(name for name in ("a", "", "c"))).names == ["a", "", "c"]


def test_several_of_a_kind_come_as_anything(mesh, cut):
    # Regression: a set was one object, and a column of a table was asked for its row 0.
    for landmarks in ({5, 8}, (n for n in (5, 8)), np.array([5, 8]), range(5, 9, 3)):
        assert len(nystrom_stream.quality(*mesh, landmarks=landmarks)) == 2
    for landmarks in (5, np.int64(5), np.array(5)):
        assert len(nystrom_stream.quality(*mesh, landmarks=landmarks)) == 1

    class Column:
        """Labels as pandas has them: indexed by what names the rows."""

        def __init__(self, values):
            self.values = values

        def __len__(self):
            return len(self.values)

        def __getitem__(self, name):
            raise KeyError(name)

        def __array__(self, dtype=None, copy=None):
            return np.asarray(self.values, dtype)

    assert nystrom_stream.evaluate(cut, Column(cut.labels))["rand"] == 0
    assert nystrom_stream.evaluate(cut, [Column(cut.labels)] * 2)["rand"] == 0
    assert nystrom_stream.evaluate(cut, (cut.labels for _ in range(2)))["rand"] == 0
    assert nystrom_stream.evaluate(cut, np.stack([cut.labels] * 2))["rand"] == 0


def test_numbers_that_are_none_name_their_option(mesh, cut):
    # Regression: the JSON between Python and the library was complained of, and `tilt` was called `turn`.
    for name, others in [("beta", {}), ("eta", {}), ("delta", {"metric": "paper"}), ("sigma", {"cluster": "kmeans"}), ("detail", {})]:
        for value in (np.nan, np.inf, -np.inf):
            with pytest.raises(ValueError, match=f"^{name}: "):
                nystrom_stream.segment(*mesh, **{name: value}, **others)
        with pytest.raises(TypeError, match=f"^{name}: 'x' is not a number"):
            nystrom_stream.segment(*mesh, **{name: "x"}, **others)
    for name in ("turn", "tilt"):
        with pytest.raises(ValueError, match=f"^{name}: "):
            cut.picture(**{name: np.inf})
    for options in ({"parts": 3, "detail": 0.5}, {"cluster": "two-means", "detail": 0.5}):
        with pytest.raises(ValueError, match="^detail: "):
            nystrom_stream.segment(*mesh, **options)
    # All this before a mesh is read.
    for name, value in [("detail", 2), ("eta", 2.0), ("landmarks", 10**6), ("parts_range", (5, 2))]:
        with pytest.raises(ValueError, match=f"^{name}: "):
            nystrom_stream.segment("none.ply", **{name: value})
    with pytest.raises(ValueError, match="^sigma: -1 is not a width"):
        nystrom_stream.segment("none.ply", parts=3, cluster="kmeans", sigma=-1)
    with pytest.raises(ValueError, match="^hints: hints need the hierarchy of parts; use cluster='parts'"):
        nystrom_stream.segment(*mesh, 3, cluster="kmeans", hints=cut.labels)


def test_sizes_are_those_of_the_program():
    for text, size in [("2G", 2 << 30), ("512M", 512 << 20), ("5 k", 5 << 10), ("1T", 1 << 40), ("1.5 GB", 1_500_000_000), (" 64 mib ", 64 << 20)]:
        assert nystrom_stream._meshes.as_bytes(text) == size
    for text in ("", "G", "1PB", "1,5GB", "inf"):
        with pytest.raises(ValueError, match="max_memory: "):
            nystrom_stream._meshes.as_bytes(text)


def test_a_path_without_an_ending_is_a_folder(cut, tmp_path):
    # Regression: pathlib drops the slash that said so.
    cut.save(Path(f"{tmp_path}/parts/"))
    cut.save(tmp_path / "parts", part_form="stl")
    assert len(list((tmp_path / "parts").glob("*.stl"))) == 3
    with pytest.raises(ValueError, match=r"path: .*\.html"):
        cut.save(f"{tmp_path}/other")


def test_two_runs_in_one_work_dir_are_told_of_runs(mesh, tmp_path):
    # Regression: a thread of one's own was another process.
    def meanwhile(*_):
        nystrom_stream.segment(*mesh, 2, work_dir=tmp_path / "work")

    with pytest.raises(ValueError, match="in use by another run"):
        nystrom_stream.segment(*mesh, 3, work_dir=tmp_path / "work", progress=meanwhile)


def test_masks_are_heeded(mesh, cut):
    """Masked corners were corners, masked vertices places, and masked labels and hints values."""
    vertices, faces = mesh
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
    masked = np.ma.masked_array([[0, 1, 2, 0], [0, 1, 2, 3]], mask=[[0, 0, 0, 1], [0, 0, 0, 0]])
    assert nystrom_stream.measure(square, masked)["quads"] == 1
    assert nystrom_stream.measure(square, np.ma.masked_array([[0, 1, 2, 3]]))["quads"] == 1
    with pytest.raises(ValueError, match="vertices: some values are masked"):
        nystrom_stream.measure(np.ma.masked_array(square, mask=np.eye(4, 3)), [[0, 1, 2]])
    # Regression: lists of masked rows lost their masks, as did colours and confidences.
    assert nystrom_stream.measure(square, list(masked))["quads"] == 1
    with pytest.raises(ValueError, match="vertices: some values are masked"):
        nystrom_stream.measure(list(np.ma.masked_array(square, mask=np.eye(4, 3))), [[0, 1, 2]])
    with pytest.raises(ValueError, match="colours: some values are masked"):
        cut.picture(colours=np.ma.masked_array(np.zeros((len(cut), 3)), mask=True))
    none = np.ma.masked_array(np.arange(len(faces)), mask=True)
    assert (nystrom_stream.segment(vertices, faces, 3, hints=none).labels == cut.labels).all()
    labels = np.ma.masked_array(cut.labels, mask=cut.labels == 0)
    carried = nystrom_stream.transfer_labels(mesh, mesh, labels)
    assert (carried.labels[cut.labels != 0] == cut.labels[cut.labels != 0]).all()
    with pytest.raises(ValueError, match="labels: some values are masked"):
        nystrom_stream.evaluate(labels, cut.labels, mesh)
    # Regression: truths lost their mask, and what was under it counted.
    for truths in (labels, [labels], np.ma.stack([labels, labels])):
        with pytest.raises(ValueError, match="truths: some values are masked"):
            nystrom_stream.evaluate(cut, truths)


def test_tables_of_nullable_types_are_taken(mesh):
    # Regression: they were not arrays of numbers.
    pandas = pytest.importorskip("pandas")
    vertices, faces = (pandas.DataFrame(table) for table in mesh)
    expected = nystrom_stream.segment(*mesh, 3).labels
    assert (nystrom_stream.segment(vertices.astype("Float64"), faces.astype("Int64"), 3).labels == expected).all()
    vertices = vertices.astype("Float64")
    vertices.iloc[0, 0] = pandas.NA
    with pytest.raises(TypeError, match="vertices: not an array of numbers"):
        nystrom_stream.segment(vertices, faces, 3)


def test_integers_of_several_types_are_faces(mesh):
    """NumPy makes floating-point numbers of unsigned and signed ones, which were refused."""
    square = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    mixed = [np.array([0, 1, 2], np.uint64), np.array([0, 1, 2, 3])]
    assert nystrom_stream.measure(square, mixed)["quads"] == 1
    assert nystrom_stream.measure(square, [[0, 1, 2], []])["incomplete_faces"] == 1


def test_what_makes_no_sense_names_its_option(mesh, cut, tmp_path):
    vertices, faces = mesh
    for option, call in {
        "faces": lambda: nystrom_stream.segment(vertices, iter(faces)),
        "faces:": lambda: nystrom_stream.segment(vertices, [[0, 1, 2], None]),
        "faces: a ndarray": lambda: nystrom_stream.segment(vertices, np.array(None)),
        "faces: a dict": lambda: nystrom_stream.segment(vertices, {}),
        "parts_range": lambda: nystrom_stream.segment(vertices, faces, parts_range=5),
        "size": lambda: nystrom_stream.picture(cut, size=5),
        "names": lambda: nystrom_stream.segment(vertices, faces, names=5),
        "truths": lambda: nystrom_stream.evaluate(cut, None),
        r"truths: float64 is not an integer type; give truths.astype\(int\)": lambda: nystrom_stream.evaluate(cut, cut.labels.astype(float)),
        "truths: 5": lambda: nystrom_stream.evaluate(cut, 5),
        "truths: np.int64|truths: 6": lambda: nystrom_stream.evaluate(cut, np.int64(6)),
        r"truths: array\(7\)": lambda: nystrom_stream.evaluate(cut, np.array(7)),
        "faces: missing": lambda: nystrom_stream.segment(vertices),
        "samplings": lambda: nystrom_stream.quality(vertices, faces, samplings=None),
        "force": lambda: nystrom_stream.segment(vertices, faces, force="no"),
        "exact": lambda: nystrom_stream.segment(vertices, faces, exact="no"),
        "transparent": lambda: nystrom_stream.picture(cut, transparent=1),
        "turn": lambda: nystrom_stream.picture(cut, turn="x"),
        "progress": lambda: nystrom_stream.segment(vertices, faces, progress=5),
        "work_dir": lambda: nystrom_stream.segment(vertices, faces, work_dir=5),
        "cap": lambda: cut.save(tmp_path / "parts", cap="no"),
        "part_form": lambda: cut.save(tmp_path / "parts", part_form=None),
    }.items():
        with pytest.raises(TypeError, match=option):
            call()
    with pytest.raises(ValueError, match="truths: none is given"):
        nystrom_stream.evaluate(cut, [])
    with pytest.raises(ValueError, match="seeds"):
        nystrom_stream.quality(vertices, faces, seeds=2**62)
    with pytest.raises(TypeError):
        cut[0:1]
    cut.save(os.fsencode(tmp_path / "labels.npy"))
    assert (np.load(tmp_path / "labels.npy") == cut.labels).all()
    assert typing.get_type_hints(nystrom_stream.segment)["force"] is bool


def test_labels_may_be_any_numbers(mesh, cut, tmp_path):
    # Regression: there was a colour for each number up to the greatest label, 12 GB here.
    size = (320, 240)
    numbers = np.array([4_000_000_000, 7, 3_000_000_000])[cut.labels]
    image = nystrom_stream.picture(mesh, numbers, size=size)
    ranks = np.array([2, 0, 1])[cut.labels]
    names = ["7", "3000000000", "4000000000"]
    assert (image == nystrom_stream.picture(mesh, ranks, names=names, size=size)).all()
    named = nystrom_stream.picture(mesh, numbers, names={7: "bar"}, size=size)
    assert (named == nystrom_stream.picture(mesh, ranks, names=["bar", *names[1:]], size=size)).all()
    some = np.where(cut.labels == 1, -1, numbers.astype(np.int64))
    assert nystrom_stream.picture(mesh, some, size=size).shape == (240, 320, 4)
    carried = nystrom_stream.transfer_labels(mesh, mesh, numbers)
    assert (carried.labels == numbers).all() and (carried.picture(size=size) == image).all()
    carried.save(tmp_path / "carried.npy")
    assert (np.load(tmp_path / "carried.npy") == numbers).all()
    for call in (lambda: carried.colours, carried.to_trimesh, lambda: carried.save(tmp_path / "carried.ply")):
        with pytest.raises(ValueError, match="labels: 4000000000 .* number the parts from 0"):
            call()
    # Numbers of parts with gaps are coloured as the program colours them.
    assert len(nystrom_stream.transfer_labels(mesh, mesh, 1000 * cut.labels).colours) == 2001


def test_labels_are_read_from_files(mesh, cut, tmp_path):
    size = (64, 48)
    files = [tmp_path / name for name in ("x.seg", "x.npy", "x.ply")]
    for file in files:
        cut.save(file)
        assert nystrom_stream.evaluate(cut, file)["rand"] == nystrom_stream.evaluate(str(file), cut.labels, mesh)["rand"] == 0
        assert (nystrom_stream.picture(mesh, file, size=size) == nystrom_stream.picture(mesh, cut.labels, size=size)).all()
        assert (nystrom_stream.transfer_labels(mesh, mesh, file).labels == cut.labels).all()
    assert nystrom_stream.evaluate(cut, files)["rand"] == 0
    np.save(tmp_path / "some.npy", np.where(cut.labels == 1, -1, cut.labels.astype(int)))
    assert (nystrom_stream.transfer_labels(mesh, mesh, tmp_path / "some.npy").labels < 3).all()
    with pytest.raises(ValueError, match="truths: .*some.npy has faces without a label"):
        nystrom_stream.evaluate(cut, [tmp_path / "some.npy"])
    with pytest.raises(FileNotFoundError):
        nystrom_stream.evaluate(cut, tmp_path / "none.seg")
    nystrom_stream.segment(mesh, cluster="components").save(tmp_path / "plain.obj")
    with pytest.raises(ValueError, match="plain.obj: has no labels"):
        nystrom_stream.evaluate(cut, tmp_path / "plain.obj")


def test_parts_that_are_not_there_are_named(cut):
    # Regression: "range object index out of range".
    for call in (cut.place, cut.__getitem__):
        for part in (3, -4):
            with pytest.raises(IndexError, match=f"there is no part {part}; the 3 parts are counted from 0"):
                call(part)
    assert (cut[-1] == cut[2]).all() and cut.place(-1) == cut.place(2) and len(list(cut)) == 3


def test_arrays_of_a_result_may_have_other_types(cut, mesh, tmp_path):
    # Regression: "type mismatch: from=float64, to=float32", in two lines, and nothing was said of which array.
    import copy

    other = copy.copy(cut)
    other.quality, other.labels = cut.quality.astype(float), cut.labels.astype(np.int16)
    cut.save(tmp_path / "cut.ply")
    other.save(tmp_path / "other.ply")
    assert (tmp_path / "other.ply").read_bytes() == (tmp_path / "cut.ply").read_bytes()
    found = nystrom_stream.correspond(mesh, mesh, landmarks=12)
    found.save(tmp_path / "found.npy")
    found.matches, found.distances = found.matches.astype(np.int32), found.distances.astype(float)
    found.save(tmp_path / "other.npy")
    assert (tmp_path / "other.npy").read_bytes() == (tmp_path / "found.npy").read_bytes()


def test_a_relative_work_dir_stays_where_it_was(mesh, tmp_path, monkeypatch):
    """Edits looked for it wherever the process was by then."""
    monkeypatch.chdir(tmp_path)
    cut = nystrom_stream.segment(*mesh, 4, work_dir="work")
    (tmp_path / "other").mkdir()
    monkeypatch.chdir(tmp_path / "other")
    edited = cut.edit({"edit": "split", "at": cut.place(0)})
    assert "rows" not in edited.report["seconds"] and not (tmp_path / "other" / "work").exists()


def test_what_a_form_loses_is_warned_of(mesh, tmp_path):
    vertices, faces = mesh
    far = nystrom_stream.segment(np.asarray(vertices, np.float64) + 1e9, faces, 3)
    with pytest.warns(UserWarning, match="STL") as warned:
        far.save(tmp_path / "parts", part_form="stl")
    # Regression: it was of a line of the package.
    assert warned[0].filename == __file__


def test_polygons_become_triangles_that_do_not_leave_them(tmp_path):
    # Regression: they were fans, so that the notch of an L was filled.
    corners = [(3, 1), (1, 1), (1, 3), (0, 3), (0, 0), (3, 0)]
    path = tmp_path / "l.obj"
    path.write_text("".join(f"v {x} {y} 0\n" for x, y in corners) + "f 1 2 3 4 5 6\n")
    vertices, triangles = nystrom_stream.read_mesh(path)
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    assert len(triangles) == 4 and area == pytest.approx(5)


def test_pictures_keep_to_their_memory(cut):
    # Regression: the error named `max_memory`, which pictures did not take.
    assert cut.picture(size=(64, 48), max_memory="1GiB").shape == (48, 64, 4)
    with pytest.raises(MemoryError, match="max_memory"):
        cut.picture(size=(4096, 4096), max_memory="1MiB")


def test_pictures_have_the_names_of_parts(tmp_path):
    # Regression: the legend had numbers, where that of a saved picture had names.
    cut = nystrom_stream.segment(*dumbbell(), parts=3, names=["left ball", "bar", "right ball"])
    size = (640, 480)
    named = cut.picture(size=size)
    assert (named != cut.picture(size=size, names=[])).any()
    assert (named == nystrom_stream.picture(cut, names=cut.names, size=size)).all()
    assert (named == cut.picture(size=size, names={0: "left ball", 1: "bar", 2: "right ball"})).all()


def test_rows_of_different_lengths_are_refused_by_name(mesh, cut):
    # Regression: NumPy's own message did not say of what.
    ragged = [[1], [1, 2]]
    for name, wrong in [("labels", lambda: nystrom_stream.evaluate(ragged, cut.labels, mesh)),
                        ("labels", lambda: nystrom_stream.picture(mesh, ragged)),
                        ("labels", lambda: nystrom_stream.transfer_labels(mesh, mesh, ragged)),
                        ("hints", lambda: nystrom_stream.segment(*mesh, hints=ragged)),
                        ("colours", lambda: cut.picture(colours=ragged))]:
        with pytest.raises(ValueError, match=f"^{name}: "):
            wrong()


def test_tables_and_pages_have_a_colour_for_each_label(cut, tmp_path):
    # Regression: labels that were assigned, beyond the colours, were written there.
    changed = copy.deepcopy(cut)
    changed.labels[:] = 77
    for name in ("x.csv", "x.html", "x.ply"):
        with pytest.raises(ValueError, match="colours: 3 for "):
            changed.save(tmp_path / name)
        assert not (tmp_path / name).exists()
