"""The bindings against the file way, NumPy's types, errors, progress, threads, and other tools' meshes."""

import json
import re
import signal
import subprocess
import sys
import threading

import numpy as np
import pytest

import nystrom_stream


def dumbbell(n=40):
    """Two balls on a bar: a surface of revolution with three obvious parts."""
    t = np.linspace(0.02, np.pi - 0.02, 6 * n)
    profile = 0.25 + 0.75 * np.abs(np.cos(t)) ** 3
    radius = profile * np.sin(t) ** 0.5
    x = -4 * np.cos(t)
    a = np.linspace(0, 2 * np.pi, n, endpoint=False)
    vertices = np.stack(
        [np.repeat(x, n), np.outer(radius, np.cos(a)).ravel(), np.outer(radius, np.sin(a)).ravel()], axis=1
    )
    i, j = np.meshgrid(np.arange(6 * n - 1), np.arange(n), indexing="ij")
    p, q = (i * n + j).ravel(), (i * n + (j + 1) % n).ravel()
    faces = np.concatenate([np.stack([p, p + n, q], 1), np.stack([q, p + n, q + n], 1)])
    return vertices, faces


@pytest.fixture(scope="module")
def mesh():
    return dumbbell()


def test_parts_found_and_given(mesh):
    vertices, faces = mesh
    cut = nystrom_stream.segment(vertices, faces)
    assert cut.labels.shape == (len(faces),) and cut.labels.dtype == np.uint32
    assert cut.quality.shape == (len(faces),) and 0 <= cut.quality.min() <= cut.quality.max() <= 1
    found = len(cut.report["parts"])
    assert set(np.unique(cut.labels)) == set(range(found)) and cut.colours.shape == (found, 3)
    assert cut.tree is not None and "unions" in cut.tree
    assert cut.cells.shape == cut.labels.shape and cut.cells.dtype == np.uint32
    assert f"{found} parts" in repr(cut)
    for parts in (2, 3, 5):
        assert len(np.unique(nystrom_stream.segment(vertices, faces, parts).labels)) == parts
    means = nystrom_stream.segment(vertices, faces, 3, cluster="kmeans", landmarks=12)
    assert len(np.unique(means.labels)) == 3 and means.tree is None and means.cells is None


def test_connected_components(mesh):
    vertices, faces = mesh
    pair = np.concatenate([vertices, 0.5 * vertices + [0, 5, 0]]), np.concatenate([faces + len(vertices), faces])
    cut = nystrom_stream.segment(*pair, cluster="components")
    assert (cut.labels == np.repeat([1, 0], len(faces))).all() and cut.tree is None
    # Regression: "K-means and 2-means have no hierarchy".
    for call in (cut.recut, cut.cut):
        with pytest.raises(ValueError, match="no hierarchy of parts; cut with cluster='parts'"):
            call(2)
    # Regression: weights, which the program refuses, had no effect in silence.
    for option in [{"parts": 2}, {"landmarks": 9}, {"exact": True}, {"walls": "own"}, {"sigma": 1.0}, {"metric": "paper"}, {"beta": 1.0}]:
        with pytest.raises(ValueError):
            nystrom_stream.segment(*pair, cluster="components", **option)


def test_types_and_views_change_nothing(mesh):
    vertices, faces = mesh
    vertices = vertices.astype(np.float32)
    expected = nystrom_stream.segment(vertices, faces, 3).labels
    for kind in (np.int32, np.int64, np.uint32, np.uint64):
        assert (nystrom_stream.segment(vertices, faces.astype(kind), 3).labels == expected).all()
    assert (nystrom_stream.segment(vertices.astype(np.float64), faces, 3).labels == expected).all()
    fortran, strided = np.asfortranarray(vertices), np.repeat(faces, 2, axis=0)[::2]
    assert (nystrom_stream.segment(fortran, strided, 3).labels == expected).all()
    assert (nystrom_stream.segment(vertices, faces, 3, threads=1).labels == expected).all()


def test_files_and_arrays_agree(mesh, tmp_path):
    vertices, faces = mesh
    path = tmp_path / "mesh.ply"
    with open(path, "wb") as out:
        out.write(
            f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\nproperty float x\n"
            f"property float y\nproperty float z\nelement face {len(faces)}\n"
            "property list uchar int vertex_indices\nend_header\n".encode()
        )
        out.write(vertices.astype("<f4").tobytes())
        record = np.zeros(len(faces), dtype=[("count", "u1"), ("at", "<i4", 3)])
        record["count"], record["at"] = 3, faces
        out.write(record.tobytes())
    by_file = nystrom_stream.segment_file(path, 4)
    by_arrays = nystrom_stream.segment(vertices.astype(np.float32), faces, 4)
    assert (by_file.labels == by_arrays.labels).all()
    read_vertices, read_faces = nystrom_stream.read_mesh(path)
    assert (read_vertices == vertices.astype(np.float32)).all() and (read_faces == faces).all()


def test_arrays_leave_no_file(mesh, tmp_path):
    vertices, faces = mesh
    seen = set()
    # A folder may be there, with nothing but its lock.
    look = lambda *_: seen.update(path.name for path in tmp_path.rglob("*") if path.is_file())  # noqa: E731
    nystrom_stream.segment(vertices, faces, 3, tmp=tmp_path, progress=look)
    assert seen <= {"lock"}


def test_results_are_cut_again_and_saved(mesh, tmp_path):
    vertices, faces = mesh
    cut = nystrom_stream.segment(vertices, faces, 4)
    assert len(cut) == 4 and sum(len(cut[part]) for part in range(4)) == len(faces)
    assert (cut.labels[cut[2]] == 2).all()
    with pytest.raises(IndexError):
        cut[4]
    rough = cut.recut(3)
    assert rough.shape == (len(faces),) and len(np.unique(rough)) == 3
    cut.save(tmp_path / "cut.npy")
    assert (np.load(tmp_path / "cut.npy") == cut.labels).all()
    cut.save(tmp_path / "cut.ply")
    assert (nystrom_stream.read_mesh(tmp_path / "cut.ply")[1] == faces).all()
    with pytest.raises(ValueError, match="unknown extension"):
        cut.save(tmp_path / "cut.xyz")


def test_work_dir_is_reused(mesh, tmp_path):
    vertices, faces = mesh
    first = nystrom_stream.segment(vertices, faces, 4, work_dir=tmp_path / "work")
    again = nystrom_stream.segment(vertices, faces, 3, work_dir=tmp_path / "work")
    assert "rows" in first.report["seconds"] and "rows" not in again.report["seconds"]
    assert (again.labels == nystrom_stream.segment(vertices, faces, 3).labels).all()


def test_a_work_dir_is_of_arrays_whoever_makes_them(mesh, tmp_path):
    # Arrays were known by a hash of Rust's own, which differs from release to release.
    vertices, faces = mesh
    np.savez(tmp_path / "mesh.npz", vertices=vertices, faces=faces)
    script = (
        "import sys, numpy, nystrom_stream\nmesh = numpy.load(sys.argv[1])\n"
        "nystrom_stream.segment(mesh['vertices'], mesh['faces'], 4, work_dir=sys.argv[2])\n"
    )
    subprocess.run([sys.executable, "-c", script, tmp_path / "mesh.npz", tmp_path / "work"], check=True)
    again = nystrom_stream.segment(vertices, faces.astype(np.int64), 4, work_dir=tmp_path / "work")
    assert "rows" not in again.report["seconds"]
    manifest = json.loads((tmp_path / "work" / "manifest.json").read_text())
    assert re.fullmatch("[0-9a-f]{16}", manifest["stages"]["graph"]["inputs"]["input"]["content"])
    moved = vertices.copy()
    moved[0, 0] = np.nextafter(moved[0, 0], 9)
    with pytest.raises(ValueError, match="belongs to another mesh|an earlier version of") as refused:
        nystrom_stream.segment(moved, faces, 4, work_dir=tmp_path / "work")
    assert "force=True" in str(refused.value) and "--" not in str(refused.value)
    assert "rows" in nystrom_stream.segment(moved, faces, 4, work_dir=tmp_path / "work", force=True).report["seconds"]


def test_a_hierarchy_is_never_that_of_an_older_run(mesh, tmp_path):
    vertices, faces = mesh
    work = tmp_path / "work"
    assert nystrom_stream.segment(vertices, faces, 4, work_dir=work).tree is not None
    means = nystrom_stream.segment(vertices, faces, 4, cluster="kmeans", landmarks=12, work_dir=work)
    assert means.tree is None
    with pytest.raises(ValueError, match="hierarchy"):
        means.recut(3)
    # A large mesh is contracted, a small one is not.
    large, small = dumbbell(90), dumbbell(20)
    contracted = nystrom_stream.segment(*large, 4, work_dir=work, force=True)
    assert len(large[1]) > 60_000 and len(np.unique(contracted.recut(3))) == 3
    fresh = nystrom_stream.segment(*small, 4)
    after = nystrom_stream.segment(*small, 4, work_dir=work, force=True)
    assert after.tree == fresh.tree and (after.recut(3) == fresh.recut(3)).all()
    assert nystrom_stream.segment(*large, 4).tree == contracted.tree


def test_errors_say_what_is_wrong(mesh, tmp_path):
    vertices, faces = mesh
    wrong = faces.copy()
    wrong[7, 1] = len(vertices)
    with pytest.raises(ValueError, match=r"faces\[7\]: names vertex"):
        nystrom_stream.segment(vertices, wrong)
    wrong[7, 1] = -1
    with pytest.raises(ValueError, match=r"faces\[7\]: names vertex -1"):
        nystrom_stream.segment(vertices, wrong)
    with pytest.raises(ValueError, match="columns"):
        nystrom_stream.segment(vertices[:, :2], faces)
    with pytest.raises(TypeError, match="is not a mesh"):
        nystrom_stream.segment(7)
    with pytest.raises(ValueError, match="no faces"):
        nystrom_stream.segment(vertices, faces[:0])
    with pytest.raises(TypeError, match="unexpected"):
        nystrom_stream.segment(vertices, faces, colour="red")
    with pytest.raises(ValueError, match="exclude"):
        nystrom_stream.segment(vertices, faces, 3, parts_range=(2, 4))
    for name, call in [("missing.ply", nystrom_stream.segment_file), ("none/x.ply", nystrom_stream.read_mesh)]:
        with pytest.raises(FileNotFoundError, match=name) as missing:
            call(tmp_path / name)
        assert missing.value.filename and missing.value.errno == 2
        # Regression: what to do was left out where the system names a number.
        assert "check the path" in missing.value.strerror
    # Regression: it was told of the name that a file has until it is whole.
    for name in ["x.ply", "x.seg", "x.npy", "x.html"]:
        with pytest.raises(FileNotFoundError) as missing:
            nystrom_stream.segment(vertices, faces, 2).save(tmp_path / "none" / name)
        assert missing.value.filename == str(tmp_path / "none" / name)
    # Nobody who writes Python is told of options of a command line.
    for options in [{"cluster": "kmeans"}, {"parts": 10**6}, {"parts": 0}, {"cluster": "means"}, {"detail": 2}, {"parts_range": (5, 2)},
                    {"boundaries": "front", "cluster": "two-means"}, {"cluster": "two-means", "decision": "single"}, {"sigma": 1.0},
                    {"sampling": "some"}, {"parts": 3, "detail": 0.5}, {"metric": "flat"}, {"eta": 2.0}, {"max_memory": "12 parsecs"}, {"beta": 1, "metric": "geodesic"}]:
        with pytest.raises(ValueError) as wrong:
            nystrom_stream.segment(vertices, faces, **options)
        told = str(wrong.value)
        assert "--" not in told and " -k" not in told and not told.startswith("-"), (options, told)


def test_progress_is_told_and_may_stop(mesh):
    vertices, faces = mesh
    heard = []
    nystrom_stream.segment(vertices, faces, progress=lambda *event: heard.append(event))
    assert {"graph", "rows"} <= {stage for stage, _, _ in heard}
    assert all(0 <= done for _, done, _ in heard)

    def stop(stage, done, total):
        if stage == "rows":
            raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        nystrom_stream.segment(vertices, faces, progress=stop)


def test_ctrl_c_stops_what_says_nothing_and_callbacks_come_to_the_caller(mesh):
    # Regression: signals were looked for by threads that Python gives none, so that Ctrl-C waited for the end of a stage.
    vertices, faces = mesh
    for call in [lambda: nystrom_stream.quality(vertices, faces, landmarks=[60], seeds=10_000),
                 lambda: nystrom_stream.picture((vertices, faces), size=(4000, 4000), views=6)]:
        timer = threading.Timer(0.3, signal.raise_signal, [signal.SIGINT])
        timer.start()
        with pytest.raises(KeyboardInterrupt):
            call()
            timer.join()
    threads = set()
    nystrom_stream.segment(vertices, faces, 3, progress=lambda *_: threads.add(threading.get_ident()))
    assert threads == {threading.get_ident()}


def test_python_goes_on_meanwhile(mesh):
    vertices, faces = dumbbell(120)
    ticks = []
    done = threading.Event()

    def work():
        nystrom_stream.segment(vertices, faces)
        done.set()

    thread = threading.Thread(target=work)
    thread.start()
    while not done.wait(0.002):
        ticks.append(1)
    thread.join()
    assert len(ticks) > 3, "Python's lock was held"


def test_trimesh_and_pyvista_meshes():
    trimesh = pytest.importorskip("trimesh", exc_type=ImportError)
    ball = trimesh.creation.icosphere(subdivisions=4)
    cut = nystrom_stream.segment(ball.vertices.view(np.ndarray), ball.faces.view(np.ndarray), 4)
    ball.visual.face_colors = cut.colours[cut.labels]
    assert len(np.unique(cut.labels)) == 4
    pyvista = pytest.importorskip("pyvista", exc_type=ImportError)
    surface = pyvista.Sphere(theta_resolution=60, phi_resolution=60).triangulate()
    cut = nystrom_stream.segment(np.asarray(surface.points), surface.faces.reshape(-1, 4)[:, 1:], 4)
    surface.cell_data["part"] = cut.labels
    assert surface.n_cells == len(cut.labels)


def test_a_mesh_is_matched_with_itself_moved(mesh):
    vertices, faces = mesh
    # Three unlike ends, so that there is one answer.
    bent = vertices * np.where(vertices[:, :1] > 0, 1.0, 0.6)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    found = nystrom_stream.correspond(bent, faces, 3.0 * bent @ turn + 5.0, faces)
    assert found.matches.shape == (len(bent),) and found.matches.dtype == np.int64
    apart = np.linalg.norm(bent[found.matches] - bent, axis=1)
    assert np.median(np.abs(bent[found.matches, 0] - bent[:, 0])) < 0.1, np.median(apart)
    assert found.distances.shape == found.confidence.shape == found.matches.shape
    assert 0 <= found.confidence.min() <= found.confidence.max() <= 1
    assert isinstance(found.report["ambiguous"], bool) and len(found.report["meshes"]) == 2
    assert repr(found) == f"Correspondence({len(bent)} vertices)"
    once = nystrom_stream.correspond(bent, faces, bent, faces, matching="one-to-one", landmarks=20)
    kept = once.matches[once.matches >= 0]
    assert len(np.unique(kept)) == len(kept)
    # A part of it: what the crop lacks has no match.
    whole, crop = (bent, faces), (bent, faces[(bent[faces, 0] < 2).all(axis=1)])
    options = {"partial": True, "refine": "laplacian", "landmarks": 30}
    part = nystrom_stream.correspond(whole, crop, **options)
    assert 0 < (part.matches < 0).mean() < 1 and options.items() <= part.report["options"].items()
    with pytest.raises(ValueError, match="matching"):
        nystrom_stream.correspond(bent, faces, bent, faces, matching="some")
    with pytest.raises(TypeError, match="detail"):
        nystrom_stream.correspond(bent, faces, bent, faces, detail=0.5)


def test_matching_and_quality_have_the_options_of_the_program(mesh, tmp_path):
    # Regression: neither a sampling, a distance, a width nor a work directory could be given, and no kernel or metric to quality.
    vertices, faces = dumbbell(20)
    bent = vertices * np.where(vertices[:, :1] > 0, 1.0, 0.6)
    pair = (bent, faces), (bent @ np.diag([1.0, -1.0, 1.0]), faces)
    work = {"work_dir": tmp_path / "work", "landmarks": 12}
    options = {"sampling": "random", "distance": "edges", "refine": "none"}
    first = nystrom_stream.correspond(*pair, **work, **options, sigma=0.5)
    assert options.items() <= first.report["options"].items() and first.report["options"]["embedding"]["width"] == 0.5
    again = nystrom_stream.correspond(*pair, **work, **options, sigma=0.5)
    assert (again.matches == first.matches).all() and set(again.report["seconds"]) < set(first.report["seconds"])
    with pytest.raises(ValueError, match="force=True"):
        nystrom_stream.correspond(pair[0], mesh, **work)
    nystrom_stream.correspond(pair[0], mesh, **work, force=True)
    for option, value in [("sampling", "some"), ("distance", "air"), ("sigma", 0.0)]:
        with pytest.raises(ValueError, match=option):
            nystrom_stream.correspond(*pair, **{option: value})
    known = nystrom_stream.quality(vertices, faces, landmarks=8)
    assert known == nystrom_stream.quality(vertices, faces, landmarks=8, kernel="exponential", sigma=1, metric="scale-free", beta=5)
    for changed in [{"kernel": "polynomial"}, {"sigma": 0.5}, {"metric": "paper", "delta": 0.1}, {"beta": 1.0}]:
        assert nystrom_stream.quality(vertices, faces, landmarks=8, **changed)[0]["gamma"] != known[0]["gamma"], changed
    for option, value in [("kernel", "cubic"), ("sigma", -1.0), ("metric", "air"), ("delta", 0.1)]:
        with pytest.raises(ValueError, match=option):
            nystrom_stream.quality(vertices, faces, **{option: value})


def test_anything_that_is_a_mesh_is_taken(mesh):
    vertices, faces = mesh
    expected = nystrom_stream.segment(vertices, faces, 3).labels
    for given in [(vertices.tolist(), faces.tolist()), (vertices, faces)]:
        assert (nystrom_stream.segment(*given, 3).labels == expected).all()
        assert (nystrom_stream.segment(given, parts=3).labels == expected).all()
    whole = nystrom_stream.segment([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0]], [[0, 1, 2, 3], [1, 4, 2]], 2)
    assert whole.labels.tolist() == [0, 1] or whole.labels.tolist() == [1, 0]
    trimesh = pytest.importorskip("trimesh", exc_type=ImportError)
    assert (nystrom_stream.segment(trimesh.Trimesh(vertices, faces, process=False), parts=3).labels == expected).all()
    with pytest.raises(TypeError, match="Scene"):
        nystrom_stream.segment(trimesh.Scene(trimesh.creation.box()))
    pyvista = pytest.importorskip("pyvista", exc_type=ImportError)
    surface = pyvista.PolyData(vertices, np.insert(faces, 0, 3, axis=1).ravel())
    assert (nystrom_stream.segment(surface, parts=3).labels == expected).all()
    mixed = pyvista.PolyData(np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0]]), [4, 0, 1, 2, 3, 3, 1, 4, 2])
    assert len(nystrom_stream.segment(mixed, parts=2).labels) == 2


def test_open3d_meshes(mesh):
    open3d = pytest.importorskip("open3d", exc_type=ImportError)
    vertices, faces = mesh
    expected = nystrom_stream.segment(vertices, faces, 3).labels
    vector = open3d.utility
    plain = open3d.geometry.TriangleMesh(vector.Vector3dVector(vertices), vector.Vector3iVector(faces))
    assert (nystrom_stream.segment(plain, parts=3).labels == expected).all()
    tensor = open3d.t.geometry.TriangleMesh.from_legacy(plain)
    assert len(nystrom_stream.segment(tensor, parts=3).labels) == len(faces)
    # Regression: a KeyError.
    with pytest.raises(ValueError, match="mesh: without vertices or triangles"):
        nystrom_stream.segment(open3d.t.geometry.TriangleMesh())


def test_results_know_what_people_ask_of_them(mesh, tmp_path):
    vertices, faces = mesh
    cut = nystrom_stream.segment(vertices, faces, 4)
    assert cut.n_parts == len(cut) == 4 and "gamma" not in cut.report
    assert "gamma" in nystrom_stream.segment(vertices, faces, 3, cluster="kmeans").report
    rough = cut.cut(3)
    assert rough.n_parts == 3 and (rough.labels == cut.recut(3)).all() and rough.quality is None
    assert rough.colours.shape == (3, 3) and sum(part["faces"] for part in rough.report["parts"]) == len(faces)
    measures = cut.measure()
    assert np.isclose(sum(part["area"] for part in measures), nystrom_stream.measure(vertices, faces)["area"])
    assert all(other["length"] > 0 for part in measures for other in part["neighbours"])
    for name in ["x.ply", "x.seg", "x.npy", "x.glb", "x.parquet", "x.png", "x.html"]:
        cut.save(tmp_path / name)
        assert (tmp_path / name).stat().st_size > 100
    rough.save(tmp_path / "rough.ply")
    cut.save(f"{tmp_path}/solids/", cap=True, part_form="stl")
    assert len(list((tmp_path / "solids").glob("part_*.stl"))) == 4
    cut.save(tmp_path / "sharp.ply", split_vertices=True)
    assert len(nystrom_stream.read_mesh(tmp_path / "sharp.ply")[0]) > len(vertices)
    cut.save(tmp_path / "smooth.ply", split_faces=True)
    assert len(nystrom_stream.read_mesh(tmp_path / "smooth.ply")[1]) > len(faces)
    for name, options in {"x.seg": {"vertex_labels": True}, "x.ply": {"cap": True}, "parts/": {"part_form": "obj"}}.items():
        with pytest.raises(ValueError, match="options|part_form"):
            cut.save(f"{tmp_path}/{name}", **options)
    page = cut._repr_html_()
    assert page.startswith("<iframe srcdoc=") and "&lt;canvas" in page and page.count('"') == 10
    image = cut.picture(size=(320, 240), legend=False)
    assert image.shape == (240, 320, 4) and image.dtype == np.uint8 and len(np.unique(image.reshape(-1, 4), axis=0)) > 50
    trimesh = pytest.importorskip("trimesh", exc_type=ImportError)
    shown = cut.to_trimesh()
    assert isinstance(shown, trimesh.Trimesh) and (shown.face_attributes["label"] == cut.labels).all()
    assert (shown.visual.face_colors[:, :3] == cut.colours[cut.labels]).all()
    pytest.importorskip("pyvista", exc_type=ImportError)
    assert (cut.to_pyvista().cell_data["label"] == cut.labels).all()


def test_results_are_pickled(mesh):
    import copy
    import pickle

    vertices, faces = mesh
    for given in [(vertices, faces), (vertices.astype(np.float32), faces)]:
        cut = nystrom_stream.segment(*given, 4)
        # Regression: the protocols before 2 refused it.
        for protocol in range(pickle.HIGHEST_PROTOCOL):
            assert pickle.loads(pickle.dumps(cut, protocol)).tree == cut.tree
        again = pickle.loads(pickle.dumps(cut))
        assert (again.labels == cut.labels).all() and again.report == cut.report and again.tree == cut.tree
        assert (again.recut(3) == cut.recut(3)).all() and again.vertices.dtype == given[0].dtype
        assert (again.triangles == faces).all() and (nystrom_stream.segment(again, parts=4).labels == cut.labels).all()
    carried = nystrom_stream.transfer_labels(cut, cut)
    assert (pickle.loads(pickle.dumps(carried)).labels == carried.labels).all()
    assert copy.deepcopy(nystrom_stream.sequence(vertices, faces)).measures


def test_labels_are_carried_scored_and_drawn(mesh, tmp_path):
    vertices, faces = mesh
    cut = nystrom_stream.segment(vertices, faces, 3)
    other = dumbbell(30)
    carried = nystrom_stream.transfer_labels(cut, other)
    assert carried.labels.shape == (len(other[1]),) and set(np.unique(carried.labels)) == {0, 1, 2}
    assert 0 <= carried.report["uncertain"] <= len(other[1])
    assert (nystrom_stream.transfer_labels((vertices, faces), other, cut.labels).labels == carried.labels).all()
    # Labels that were carried are saved and shown in the colours and with the names that they had.
    assert (carried.colours == cut.colours).all() and carried.names == cut.names
    for name in ("x.ply", "x.npy", "x.glb", "x.html", "parts/"):
        carried.save(f"{tmp_path}/{name}")
    saved = nystrom_stream._meshes.as_mesh(tmp_path / "x.ply").face_property("label")
    assert (saved == carried.labels).all() and (np.load(tmp_path / "x.npy") == carried.labels).all()
    assert (carried.picture(size=(64, 48)) == nystrom_stream.picture(carried, size=(64, 48))).all()
    plain = nystrom_stream.transfer_labels((vertices, faces), other, cut.labels)
    assert len(plain.colours) == 3 and plain.names == []
    plain.save(tmp_path / "plain.ply")
    assert nystrom_stream.evaluate(cut, cut.labels)["rand"] == 0
    assert nystrom_stream.evaluate(cut.labels, [cut.labels, (cut.labels + 1) % 3], mesh=(vertices, faces))["rand"] == 0
    assert nystrom_stream.evaluate(cut, np.zeros(len(faces), int))["rand"] > 0.3
    # Regression: a result was taken for the list of its parts.
    assert nystrom_stream.evaluate(cut, cut)["rand"] == nystrom_stream.evaluate(cut, [cut, cut])["rand"] == 0
    with pytest.raises(ValueError, match=f"truths: {len(other[1])} for {len(faces)} faces"):
        nystrom_stream.evaluate(cut, nystrom_stream.segment(*other, 2))
    with pytest.raises(ValueError, match="truth"):
        nystrom_stream.evaluate(cut, [])
    assert nystrom_stream.picture((vertices, faces), size=(64, 48)).shape == (48, 64, 4)
    with pytest.raises(ValueError, match="one per face"):
        nystrom_stream.picture((vertices, faces), cut.labels[:-1])


def test_orders_and_samples(mesh):
    vertices, faces = mesh
    ordered = nystrom_stream.sequence(vertices, faces, order="hilbert")
    assert sorted(ordered.places) == list(range(len(faces))) == sorted(ordered.order)
    assert (ordered.places[ordered.order] == np.arange(len(faces))).all() and len(ordered.vertex_numbers) == len(vertices)
    streamed, placed = ordered.vertex_numbers[faces[ordered.order]], vertices[np.argsort(ordered.vertex_numbers)]
    assert (placed[streamed] == vertices[faces[ordered.order]]).all() and streamed[0].max() == 2
    few, many = nystrom_stream.quality(vertices, faces, landmarks=[5, 20], samplings="farthest")
    assert many["gamma"] > few["gamma"] > 0
    assert nystrom_stream.measure(vertices, faces)["boundary_loops"] == 2


def test_every_option_of_the_program_has_an_effect_or_is_refused(mesh):
    vertices, faces = mesh
    cut = lambda **options: nystrom_stream.segment(vertices, faces, 4, **options)  # noqa: E731
    for options, key, told in [
        ({"metric": "paper", "delta": 0.1}, "metric", {"form": "paper", "delta": 0.1, "eta": 0.1}),
        ({"sampling": "random"}, "sampling", "random"),
        ({"order": "hilbert"}, "order", "hilbert"),
        ({"tiny_components": "own"}, "tiny_components", "own"),
        ({"walls": "own"}, "walls", "own"),
        ({"boundaries": "embedding"}, "boundaries", "embedding"),
        ({"max_memory": "1GiB"}, "cluster", "parts"),
    ]:
        found = cut(**options).report["options"][key]
        if isinstance(told, dict):
            assert found.keys() == told.keys() and all(found[k] == pytest.approx(v) if k != "form" else found[k] == v
                                                       for k, v in told.items())
        else:
            assert found == told
    assert cut(decision="single").report["options"]["parts"]["decision"] == "single"
    means = cut(cluster="kmeans", kernel="polynomial", sigma=0.5, normalise="none", unit_rows=False).report["options"]["embedding"]
    assert means["kernel"]["kernel"] == "polynomial" and means["unit_rows"] is False and means["normalisation"] == "none"


def test_signatures_and_docstrings_are_there():
    import inspect

    for name in nystrom_stream.__all__:
        thing = getattr(nystrom_stream, name)
        if callable(thing):
            assert thing.__doc__ and len(thing.__doc__) > 40, name
    assert "detail" in inspect.signature(nystrom_stream.segment).parameters
    assert inspect.signature(nystrom_stream.segment).parameters["faces"].default is None


def test_numbers_beyond_32_bits_and_odd_colours_are_refused(mesh):
    # Regression: they wrapped around in silence, and the colours panicked.
    with pytest.raises(ValueError):
        nystrom_stream.segment(np.eye(3), [[0, 1, 2], [0, 1, 2, 2**32]])
    cut = nystrom_stream.segment(*mesh, 2)
    labels = cut.labels.astype(np.int64)
    with pytest.raises(ValueError, match="exceeds 32 bits"):
        nystrom_stream.evaluate(cut, np.where(labels == 0, 2**32 + 1, labels))
    with pytest.raises(ValueError, match="red, green and blue"):
        nystrom_stream.picture(mesh, cut.labels, colours=np.zeros((5, 2), np.uint8))
    with pytest.raises(ValueError, match="landmarks"):
        nystrom_stream.quality(*mesh, landmarks=0)


def test_numbers_and_words_that_make_no_sense_are_named(mesh):
    # Regression: a negative number was an OverflowError without a name, and a wrong word was told without its option.
    cut = nystrom_stream.segment(*mesh, 2)
    of_cut, of_pair = [(nystrom_stream.segment, mesh)], [(nystrom_stream.correspond, (mesh, mesh))]
    others = [(nystrom_stream.sequence, mesh), (nystrom_stream.quality, mesh)]
    for calls, names in [(of_cut + of_pair + others, ["seed", "threads", "landmarks", "max_memory"]), (of_cut, ["parts"]),
                         (of_pair, ["alternative", "vectors"]), (others[:1], ["smooth"]), (others[1:], ["seeds"])]:
        for (call, given), name in [(call, name) for call in calls for name in names]:
            with pytest.raises(ValueError, match=f"{name}: -3 is too small; choose [01] or more"):
                call(*given, **{name: -3})
            with pytest.raises((TypeError, ValueError), match=name):
                call(*given, **{name: 2.5})
    for name in ["sampling", "decision", "tiny_components", "walls", "boundaries", "order", "cluster", "metric", "kernel", "normalise"]:
        with pytest.raises(ValueError, match=f"{name}: 'x'; choose .* or "):
            nystrom_stream.segment(*mesh, **{name: "x"})
    # Regression: "expected value".
    with pytest.raises(ValueError, match="order: None; choose auto"):
        nystrom_stream.segment(*mesh, order=None)
    with pytest.raises(ValueError, match="samplings: none is given"):
        nystrom_stream.quality(*mesh, samplings=[])
    with pytest.raises(ValueError, match="order: 'x'; choose spectral"):
        nystrom_stream.sequence(*mesh, order="x")
    with pytest.raises(ValueError, match="samplings: 'x'; choose farthest"):
        nystrom_stream.quality(*mesh, samplings=["x"])
    with pytest.raises(ValueError, match="up: 'x2'; choose x"):
        nystrom_stream.picture(cut, up="x2")
    with pytest.raises(ValueError, match="parts: -1"):
        cut.recut(-1)
    with pytest.raises(ValueError, match="seed: .* is too large"):
        nystrom_stream.segment(*mesh, seed=2**64)
    assert nystrom_stream.segment(*mesh, np.int64(2), seed=np.uint64(0)).n_parts == 2


def test_the_library_knows_every_word_that_is_offered():
    from typing import get_args

    from nystrom_stream import _functions

    square = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0]], [[0, 1, 2, 3], [1, 4, 2]]
    for name, words in [("sampling", _functions.Sampling), ("decision", _functions.Decision), ("order", _functions.Order),
                        ("tiny_components", _functions.TinyComponents), ("walls", _functions.Walls),
                        ("boundaries", _functions.Boundaries), ("metric", _functions.Metric), ("cluster", _functions.Cluster)]:
        for word in get_args(words):
            # Connected components take no number of parts; here there is one.
            parts = None if word == "components" else 1
            assert nystrom_stream.segment(*square, parts, **{name: word}).n_parts == 1
    for name, words in [("kernel", _functions.Kernel), ("normalise", _functions.Normalise)]:
        for word in get_args(words):
            assert nystrom_stream.segment(*square, 1, cluster="kmeans", **{name: word}).n_parts == 1
    for word in get_args(_functions.StreamOrder):
        assert sorted(nystrom_stream.sequence(*square, order=word).places) == [0, 1]
    for word in get_args(_functions.Axis):
        assert nystrom_stream.picture(square, size=(32, 32), up=word).shape == (32, 32, 4)


class Block:
    """A block of cells as meshio has it."""

    def __init__(self, kind, data):
        self.type, self.data = kind, np.array(data)


class Blocks:
    """A mesh as meshio has it."""

    def __init__(self, points, cells):
        self.points, self.cells = np.array(points, float), [Block(*cell) for cell in cells]


def test_blocks_of_cells_keep_their_order():
    # Regression: all triangles came before all quads, and polygons were lost in silence.
    points = [[x, y, 0] for y in range(2) for x in range(8)]
    quad, triangles, pentagon = [[0, 1, 9, 8]], [[1, 2, 10], [1, 10, 9]], [[2, 3, 4, 12, 10]]
    given = Blocks(points, [("line", [[0, 1]]), ("quad", quad), ("triangle", triangles), ("polygon", pentagon), ("quad", [[4, 5, 13, 12]]),
                            ("triangle6", [[5, 6, 14, 0, 0, 0]])])
    mesh = nystrom_stream._meshes.as_mesh(given)
    starts, corners = mesh.polygons()
    assert starts.tolist() == [0, 4, 7, 10, 15, 19, 22]
    assert corners.tolist() == [0, 1, 9, 8, 1, 2, 10, 1, 10, 9, 2, 3, 4, 12, 10, 4, 5, 13, 12, 5, 6, 14]
    assert nystrom_stream.segment(Blocks(points, [("triangle", triangles), ("triangle", triangles[:1])]), parts=1).labels.shape == (3,)
    with pytest.raises(ValueError, match="no triangles, quads or polygons among its cells .tetra."):
        nystrom_stream.segment(Blocks(points, [("tetra", [[0, 1, 2, 9]])]))
    meshio = pytest.importorskip("meshio", exc_type=ImportError)
    real = meshio.Mesh(points, [(block.type, block.data) for block in given.cells])
    assert (nystrom_stream._meshes.as_mesh(real).polygons()[1] == corners).all()


def test_grids_are_taken_where_they_are_surfaces():
    pyvista = pytest.importorskip("pyvista", exc_type=ImportError)
    points = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0]])
    grid = pyvista.UnstructuredGrid([4, 0, 1, 2, 3, 3, 1, 4, 2], [9, 5], points)
    assert nystrom_stream._meshes.as_mesh(grid).polygons()[0].tolist() == [0, 4, 7]
    for volume in [pyvista.UnstructuredGrid([4, 0, 1, 2, 4], [10], points), pyvista.ImageData(dimensions=(3, 3, 3))]:
        with pytest.raises(TypeError, match=r"extract_surface\(\)"):
            nystrom_stream.segment(volume)
