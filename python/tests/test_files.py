"""Results of files: what becomes of them when the file changes, copies and pickles, and where files are decoded."""

import copy
import csv
import os
import pickle
import subprocess
import sys

import numpy as np
import pytest
import trimesh
from test_segment import dumbbell

import nystrom_stream

USES = {
    "vertices": lambda cut: cut.vertices,
    "triangles": lambda cut: cut.triangles,
    "place": lambda cut: cut.place(0),
    "cut": lambda cut: cut.cut(2),
    "edit": lambda cut: cut.edit([]),
    "measure": lambda cut: cut.measure(),
    "picture": lambda cut: cut.picture(size=(64, 64)),
    "save": lambda cut: cut.save(os.devnull + ".ply"),
    "pickle": pickle.dumps,
    "transfer": lambda cut: nystrom_stream.transfer_labels(cut, cut),
    "evaluate": lambda cut: nystrom_stream.evaluate(cut, cut),
    "correspond": lambda cut: nystrom_stream.correspond(cut, cut),
    "sequence": nystrom_stream.sequence,
    "quality": nystrom_stream.quality,
    "segment": lambda cut: nystrom_stream.segment(cut, parts=2),
}


def test_pickles_are_small_and_exact():
    # Regression: the decision was text of megabytes, and triangles had a start each.
    cut = nystrom_stream.segment(*dumbbell(), 3)
    assert len(pickle.dumps(cut._decision)) < 8_000_000
    triangles = len(pickle.dumps(cut._mesh)) - cut.vertices.nbytes - cut.triangles.nbytes
    assert triangles < 1000
    again = pickle.loads(pickle.dumps(cut))
    assert again.tree == cut.tree and (again.cut(5).labels == cut.cut(5).labels).all()
    edits = [{"edit": "split", "at": cut.place(0)}]
    assert (again.edit(edits).labels == cut.edit(edits).labels).all()
    mixed = [[0, 1, 2, 3], [1, 4, 2]]
    square = nystrom_stream.segment([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0]], mixed, 2)
    assert pickle.loads(pickle.dumps(square)).measure() == square.measure()


def test_parts_are_a_table(tmp_path):
    # Regression: measures did not say of which part they are, and no table of the parts was written.
    cut = nystrom_stream.segment(*dumbbell(), 3, names={1: "bar"})
    measures = cut.measure()
    assert [part["label"] for part in measures] == [0, 1, 2]
    assert [part.get("name") for part in measures] == [None, "bar", None]
    cut.save(tmp_path / "parts.csv")
    with open(tmp_path / "parts.csv", encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["area"]) for row in rows] == [part["area"] for part in measures]
    assert [row["name"] for row in rows] == ["", "bar", ""]
    expected = [part["expected_agreement"] for part in cut.report["parts"]]
    assert [float(row["expected_agreement"]) for row in rows] == [round(share, 3) for share in expected]
    assert rows[0]["colour"] == "#%02x%02x%02x" % tuple(cut.colours[0])
    with pytest.raises(ValueError, match="another format"):
        cut.save(tmp_path / "parts.csv", cap=True)


def written(path, n=20, scale=1.0):
    """A binary PLY of a dumbbell at `path`, which is mapped where it lies."""
    vertices, faces = dumbbell(n)
    nystrom_stream.segment(vertices * scale, faces, 2).save(path)
    return path


def as_obj(path, n=20):
    vertices, faces = dumbbell(n)
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()] + [f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist()]
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_result_of_a_file_that_was_written_to_says_so(tmp_path):
    # Regression: it was a map of the file, so that the geometry changed under the labels.
    path, other = written(tmp_path / "mesh.ply"), written(tmp_path / "other.ply", scale=10.0)
    cut = nystrom_stream.segment(path, parts=3)
    vertices = cut.vertices
    path.write_bytes(other.read_bytes())
    for use in USES.values():
        with pytest.raises(ValueError, match="mesh.ply has changed since it was read; cut it again"):
            use(cut)
    assert len(cut.labels) == len(cut.recut(2)) and np.allclose(nystrom_stream.segment(path, parts=3).vertices, 10 * vertices)


def test_a_shorter_file_does_not_kill_python(tmp_path):
    # Regression: SIGBUS.
    path = written(tmp_path / "mesh.ply")
    script = (
        "import sys, nystrom_stream\ncut = nystrom_stream.segment(sys.argv[1], parts=3)\nopen(sys.argv[1], 'wb').close()\n"
        "try:\n    cut.vertices\nexcept ValueError as error:\n    print(error)\n"
    )
    ran = subprocess.run([sys.executable, "-c", script, path], capture_output=True, text=True, check=True)
    assert "has changed since it was read" in ran.stdout


def test_a_file_in_the_place_of_another_leaves_its_results_alone(tmp_path):
    path = written(tmp_path / "mesh.ply")
    cut = nystrom_stream.segment(path, parts=3)
    vertices = cut.vertices
    cut.save(path)
    assert (cut.vertices == vertices).all() and cut.cut(2).n_parts == 2
    os.replace(written(tmp_path / "other.ply", scale=10.0), path)
    assert (cut.vertices == vertices).all()
    # But a work directory knows the mesh by its file, and an OBJ is written from the lines of the one that was read.
    with pytest.raises(ValueError, match="has changed"):
        nystrom_stream.segment(cut, parts=2, work_dir=tmp_path / "work")
    path = as_obj(tmp_path / "mesh.obj")
    cut = nystrom_stream.segment(path, parts=3)
    os.replace(as_obj(tmp_path / "other.obj", 24), path)
    cut.save(tmp_path / "saved.ply")
    with pytest.raises(ValueError, match="has changed"):
        cut.save(tmp_path / "saved.obj")
    path.unlink()
    cut.save(tmp_path / "saved.obj")


def test_copies_and_pickles_are_edited_with_the_work_dir(tmp_path):
    # Regression: a copy's mesh was of arrays, and the work directory of another mesh.
    path = written(tmp_path / "mesh.ply")
    cut = nystrom_stream.segment(path, parts=3, work_dir=tmp_path / "work")
    split = [{"edit": "split", "at": cut.place(0)}]
    labels = cut.edit(split).labels
    for same in (copy.copy, copy.deepcopy, lambda cut: pickle.loads(pickle.dumps(cut))):
        edited = same(cut).edit(split)
        assert "rows" not in edited.report["seconds"] and (edited.labels == labels).all()
    assert copy.copy(cut)._mesh is copy.deepcopy(cut)._mesh is cut._mesh
    deep = copy.deepcopy(cut)
    deep.names, deep.labels[:] = {0: "x"}, 0
    assert cut.names[0] == "" and cut.labels.any()
    # Without the file the work directory is left alone.
    pickled = pickle.dumps(cut)
    path.write_bytes(written(tmp_path / "other.ply", scale=10.0).read_bytes())
    for _ in range(2):
        edited = pickle.loads(pickled).edit(split)
        assert "rows" in edited.report["seconds"] and (edited.labels == labels).all()
        path.unlink(missing_ok=True)
    # Regression: a pipe in the place of the file was waited for.
    os.mkfifo(path)
    assert (pickle.loads(pickled).labels == cut.labels).all()
    vertices, faces = dumbbell(20)
    arrays = nystrom_stream.segment(vertices, faces, 3, work_dir=tmp_path / "arrays")
    edited = pickle.loads(pickle.dumps(arrays)).edit(split)
    assert "rows" not in edited.report["seconds"]


def test_a_file_is_read_as_the_call_says(tmp_path, monkeypatch):
    # Regression: it was decoded in the system's folder, whatever `tmp` said, and nothing told of it.
    path, tmp, system = as_obj(tmp_path / "mesh.obj"), tmp_path / "tmp", tmp_path / "system"
    tmp.mkdir()
    system.mkdir()
    monkeypatch.setenv("TMPDIR", str(system))
    mesh = nystrom_stream.segment(path, parts=2)
    assert list(system.rglob("*.ply")) and mesh.n_parts == 2
    del mesh
    monkeypatch.setenv("TMPDIR", str(tmp_path / "none"))
    for call, meshes in [(nystrom_stream.segment, 1), (nystrom_stream.sequence, 1), (nystrom_stream.quality, 1),
                         (nystrom_stream.correspond, 2)]:
        heard, files = [], set()

        def hear(stage, *_, heard=heard, files=files):
            heard.append(stage)
            # Folders come and go meanwhile, which `os.walk` does not mind.
            files.update(name for _, _, names in os.walk(tmp) for name in names if name.endswith(".ply"))

        result = call(*[path] * meshes, tmp=tmp, progress=hear, threads=1, max_memory="1GiB")
        assert "read" in heard and files, call
        del result
        assert not list(tmp.rglob("*.ply")), "it goes with the result"
    labels = np.zeros(len(dumbbell(20)[1]), int)
    assert nystrom_stream.transfer_labels(path, path, labels, tmp=tmp).labels.max() == 0

    def stop(stage, *_):
        raise RuntimeError(stage)

    with pytest.raises(RuntimeError, match="read"):
        nystrom_stream.segment(path, progress=stop, tmp=tmp)


def test_a_plan_is_the_programs_report(tmp_path):
    mesh = dumbbell()
    path, work = tmp_path / "mesh.ply", tmp_path / "work"
    nystrom_stream.segment(*mesh, 2).save(path)
    options = {"cluster": "kmeans", "landmarks": 12, "threads": 1, "max_memory": "64MiB"}
    told = nystrom_stream.plan(path, parts=3, calibrate=False, work_dir=work, **options)
    assert set(told) == {"mesh", "landmarks", "stages", "memory", "disk", "disk_peak", "disk_peak_smooth", "random_access_bytes",
                         "seconds", "seconds_rough", "notes"}
    assert told["mesh"]["faces"] == len(mesh[1]) and told["landmarks"] == 12 and told["notes"] == []
    assert told["seconds"] is None and not work.exists()
    # Of arrays in memory, of which nothing is decoded: the same, except that the arrays of a work directory are on the disk.
    held = nystrom_stream.plan(*mesh, 3, calibrate=False, **options)
    assert held["mesh"]["vertices"] == told["mesh"]["vertices"] and held["disk"] < told["disk"]
    cut = nystrom_stream.segment(path, parts=3, work_dir=work, **options)
    kept = sum(file.stat().st_size for file in work.rglob("*") if file.is_file())
    assert 0.8 < told["disk"] / kept < 1.2, (told["disk"], kept)
    assert nystrom_stream.plan(cut, calibrate=False)["mesh"]["faces"] == len(mesh[1])
    timed = nystrom_stream.plan(path, tmp=tmp_path, edits=[{"edit": "drop", "at": 0}], names=["a"], force=True)
    assert 0 < timed["seconds"] <= timed["seconds_rough"] and sum(stage["seconds"] for stage in timed["stages"]) > 0
    assert any(note.endswith("although `max_memory` is 1.05 MB") for note in nystrom_stream.plan(path, max_memory="1MiB")["notes"])
    with pytest.raises(FileNotFoundError):
        nystrom_stream.plan(tmp_path / "none.ply")
    with pytest.raises(ValueError, match="choose fewer parts"):
        nystrom_stream.plan(path, parts=100_000)
    with pytest.raises(ValueError, match="landmarks: -3 is too small"):
        nystrom_stream.plan(path, landmarks=-3)


def test_paths_mean_the_same_wherever_the_process_is(tmp_path, monkeypatch):
    """Regression: after os.chdir, an OBJ was saved with the vertices of another file of that name, and a work directory was one of
    another mesh."""
    for name, factor in (("a", 1), ("b", 5)):
        (tmp_path / name).mkdir()
        box = trimesh.creation.box(extents=(factor, 2 * factor, 3 * factor))
        box.export(tmp_path / name / "m.obj")
    monkeypatch.chdir(tmp_path / "a")
    cut = nystrom_stream.segment("m.obj", parts=2, work_dir="w")
    monkeypatch.chdir(tmp_path / "b")
    cut.save("y.obj")
    assert np.abs(trimesh.load(tmp_path / "b" / "y.obj", process=False, force="mesh").vertices).max() < 2
    assert len(cut.edit([{"edit": "merge", "at": [0, len(cut.labels) - 1]}])) >= 1


def test_edits_that_cannot_be_written_leave_the_file_as_it_was(tmp_path):
    cut = nystrom_stream.segment(trimesh.creation.icosphere(), parts=2)
    path = tmp_path / "e.json"
    cut.save_edits(path)
    before = path.read_text()
    (tmp_path / "e.json.partial").mkdir()
    with pytest.raises(OSError):
        cut.save_edits(path)
    assert path.read_text() == before
    (tmp_path / "e.json.partial").rmdir()
    (tmp_path / "link.json").symlink_to(path)
    cut.save_edits(tmp_path / "link.json")
    assert path.read_text() == before and sorted(os.listdir(tmp_path)) == ["e.json", "link.json"]


def test_empty_paths_and_matches_that_are_none_are_refused(tmp_path):
    ball = trimesh.creation.icosphere(subdivisions=3)
    for option in ("work_dir", "tmp"):
        with pytest.raises(ValueError, match=f"{option}: an empty text is no path"):
            nystrom_stream.segment(ball, parts=2, **{option: ""})
    m = nystrom_stream.Correspondence(np.array([0.5, 1]), np.zeros(2, np.float32), np.ones(2, np.float32), {})
    with pytest.raises(TypeError, match="matches: 1 dimensions of float64"):
        m.save(tmp_path / "m.npy")
    m.matches = np.array([-5, 1])
    with pytest.raises(ValueError, match="matches: -5 is no vertex of B"):
        m.save(tmp_path / "m.npy")
    m.matches = np.ma.masked_array([3, 1], mask=[True, False])
    m.save(tmp_path / "m.csv")
    assert "0,-1," in (tmp_path / "m.csv").read_text()


def test_confidences_that_are_not_one_per_face_are_refused(tmp_path):
    """Regression: two columns were told as "dimensionality mismatch", and masked ones were written."""
    cut = nystrom_stream.segment(trimesh.creation.icosphere(), parts=2)
    n = len(cut.labels)
    for quality, told in [
        (np.zeros((n, 2)), f"quality: {n}×2 for {n} faces; give one per face"),
        (np.zeros(3), f"quality: 3 for {n} faces"),
        (np.ma.masked_array(np.zeros(n), mask=True), "quality: some values are masked"),
    ]:
        cut.quality = quality
        with pytest.raises(ValueError, match=told):
            cut.save(tmp_path / "x.ply")
    assert os.listdir(tmp_path) == []
