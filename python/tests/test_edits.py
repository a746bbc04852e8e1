"""Corrections as people write them in Python: edits, hints, names, and the page that edits them."""

import json
import pickle

import numpy as np
import pytest
from test_segment import dumbbell

import nystrom_stream


@pytest.fixture(scope="module")
def cut():
    return nystrom_stream.segment(*dumbbell(), 4)


def agree(a, b):
    """Whether two labellings are one but for the numbers of parts, on all but a few faces."""
    table = np.zeros((a.max() + 1, b.max() + 1))
    np.add.at(table, (a, b), 1)
    return min(table.max(axis=0).sum(), table.max(axis=1).sum()) > 0.98 * len(a)


def test_a_place_lies_on_its_part(cut):
    vertices, triangles = np.asarray(cut.vertices), cut.triangles
    for part in range(cut.n_parts):
        gaps = np.linalg.norm(vertices[triangles].mean(axis=1) - cut.place(part), axis=1)
        assert cut.labels[gaps.argmin()] == part and gaps.min() < 1e-6
    with pytest.raises(IndexError):
        cut.place(4)


def test_a_place_has_numbers_where_vertices_have_none():
    # Regression: a vertex that is no number made the middle of its part one, which edits refuse.
    along = np.arange(6.0)
    vertices = np.stack([*np.meshgrid(along, along, indexing="ij"), np.zeros((6, 6))], axis=-1).reshape(-1, 3)
    faces = np.array([(v, v + 6, v + 7, v + 1) for v in range(29) if v % 6 < 5])
    vertices[0] = np.nan
    cut = nystrom_stream.segment(vertices, faces, 1)
    assert np.isfinite(cut.place(0)).all() and cut.edit({"edit": "split", "at": cut.place(0)}).n_parts == 2
    with pytest.raises(ValueError, match="part 0 has no face with finite coordinates"):
        nystrom_stream.segment(np.full((3, 3), np.nan), [[0, 1, 2]], 1).place(0)


def test_names_of_a_copy_are_its_own(cut):
    # Regression: the report of the cut that was copied told the names of the copy.
    import copy

    named = copy.copy(cut)
    named.names = {1: "left arm"}
    assert named.report["parts"][1]["name"] == "left arm" and named.names[1] == "left arm"
    assert not any(cut.names) and not any("name" in part for part in cut.report["parts"])


def test_edits_add_up_and_the_cut_before_stays(cut):
    labels, a, b = cut.labels.copy(), cut.place(0), cut.place(1)
    merged = cut.edit([{"edit": "merge", "at": [a, b]}])
    assert merged.n_parts == 3 and cut.n_parts == 4 and (cut.labels == labels).all() and cut.edits == []
    assert agree(merged.labels, np.where(labels == 1, 0, labels))
    split = merged.edit([{"edit": "split", "at": np.array(merged.place(2)), "into": np.int64(3)}])
    assert split.n_parts == 5 and [edit["edit"] for edit in split.edits] == ["merge", "split"]
    told = [*merged.edits, {"edit": "split", "at": merged.place(2), "into": 3}]
    assert (nystrom_stream.segment(*dumbbell(), 4, edits=told).labels == split.labels).all()
    # By the number of a face too.
    faces = [cut[part][len(cut[part]) // 2] for part in (0, 1)]
    assert cut.edit({"edit": "merge", "at": faces}).n_parts == 3


def test_hints_keep_apart_and_together(cut):
    labels = cut.labels
    # Faces deep within the two largest parts: boundaries beside a hint may move by a few faces.
    middles = np.asarray(cut.vertices)[cut.triangles].mean(axis=1)
    largest = np.argsort(np.bincount(labels))[-2:]
    ends = np.array([np.linalg.norm(middles - middles[labels == part].mean(axis=0), axis=1).argmin() for part in largest])
    assert labels[ends[0]] != labels[ends[1]]
    together = cut.edit([{"edit": "together", "at": ends}])
    assert together.labels[ends[0]] == together.labels[ends[1]] and together.n_parts == 3
    painted = np.zeros(len(labels), int)
    painted[ends] = 7
    hinted = nystrom_stream.segment(*dumbbell(), 4, hints=painted)
    assert hinted.n_parts == 3 and agree(hinted.labels, together.labels)
    assert hinted.edit([{"edit": "name", "at": ends[0], "name": "both"}]).n_parts == 3, "hints stay"
    for hints in (painted[1:], painted - 1, painted * 0.5):
        with pytest.raises(ValueError, match="hints: give one integer per face"):
            nystrom_stream.segment(*dumbbell(), 4, hints=hints)


def test_files_of_edits_come_and_go(cut, tmp_path):
    edited = cut.edit([{"edit": "merge", "at": [cut.place(0), cut.place(1)]}, {"edit": "name", "at": cut.place(2), "name": "bar"}])
    edited.save_edits(tmp_path / "edits.json")
    told = json.loads((tmp_path / "edits.json").read_text())
    assert told["format"] == "nystrom-stream edits" and told["parts"] == 4 and len(told["box"]) == 2
    assert told["edits"] == edited.edits
    again = nystrom_stream.segment(*dumbbell(), edits=tmp_path / "edits.json")
    assert (again.labels == edited.labels).all() and again.names == edited.names and "bar" in again.names
    # A file has all edits, so it replaces those before.
    assert edited.edit(tmp_path / "edits.json").edits == edited.edits
    (tmp_path / "edits.json").write_text(json.dumps({**told, "parts": 3}))
    three = nystrom_stream.segment(*dumbbell(), edits=tmp_path / "edits.json")
    assert (cut.edit(tmp_path / "edits.json").labels == three.labels).all()
    assert three.report["options"]["parts"]["count"] == {"exactly": 3}
    (tmp_path / "edits.json").write_text("merge them")
    with pytest.raises(ValueError, match="edits.json: not a file of edits"):
        cut.edit(tmp_path / "edits.json")


def test_saved_edits_fit_a_mesh_with_vertices_far_away(tmp_path):
    # Regression: the box that was saved had them in it, so places were scaled, and the mesh's own edits were refused.
    vertices, faces = dumbbell()
    vertices = np.vstack([vertices, [[50, 50, 50]], [[np.nan, 0, 0]]])
    cut = nystrom_stream.segment(vertices, faces, 4)
    edited = cut.edit([{"edit": "merge", "at": [cut.place(0), cut.place(1)]}])
    edited.save_edits(tmp_path / "edits.json")
    used = vertices[np.unique(faces)]
    box = json.loads((tmp_path / "edits.json").read_text())["box"]
    assert np.allclose(box, [used.min(axis=0), used.max(axis=0)])
    assert (cut.edit(tmp_path / "edits.json").labels == edited.labels).all()


def test_edits_add_to_those_of_a_file_in_other_units(tmp_path):
    # Regression: the box of the file scaled the new places too, which then were off the mesh or on another part.
    vertices, faces = dumbbell(12)
    cut = nystrom_stream.segment(vertices, faces, 4)
    cut.edit([{"edit": "merge", "at": [cut.place(0), cut.place(1)]}]).save_edits(tmp_path / "metres.json")
    large = nystrom_stream.segment(1000 * vertices, faces, edits=tmp_path / "metres.json")
    split = large.edit([{"edit": "split", "at": large.place(0)}])
    assert (large.n_parts, split.n_parts) == (3, 4)
    assert np.allclose(split.edits[0]["at"], 1000 * np.array([cut.place(0), cut.place(1)]))
    split.save_edits(tmp_path / "millimetres.json")
    for scale in (1, 1000):
        again = nystrom_stream.segment(scale * vertices, faces, edits=tmp_path / "millimetres.json")
        assert agree(again.labels, split.labels)


def test_a_protected_part_is_one_of_the_cut_that_is_edited(tmp_path):
    # Regression: it was that of the default cut, here all of the mesh, so that one part of four was left; and parts=6 beside a file
    # of edits made it forget the number that the file says, as the program does not.
    mesh = dumbbell(16)
    assert nystrom_stream.segment(*mesh).n_parts == 1
    for options in ({"parts": 4}, {"parts_range": (4, 5)}):
        cut = nystrom_stream.segment(*mesh, **options)
        kept = cut.edit([{"edit": "protect", "at": cut.place(1)}])
        assert kept.n_parts == cut.n_parts
        assert kept.edit([{"edit": "name", "at": cut.place(1), "name": "x"}]).n_parts == cut.n_parts
        kept.save_edits(tmp_path / "edits.json")
        assert json.loads((tmp_path / "edits.json").read_text())["parts"] == cut.n_parts
        more = nystrom_stream.segment(*mesh, parts=6, edits=tmp_path / "edits.json")
        own = more.labels[cut[1]]
        same = (own == np.bincount(own).argmax()).mean()
        assert more.n_parts == 6 and same > 0.9, same
        assert more.edit([{"edit": "name", "at": cut.place(1), "name": "x"}]).n_parts == 6


def test_what_a_cut_keeps_is_its_own(cut):
    # Regression: edits took painted hints from the caller's array, and edits that a cut had listed were its own dicts.
    faces = [int(cut[part][len(cut[part]) // 2]) for part in (0, 1)]
    painted = np.zeros(len(cut.labels), np.uint32)
    painted[faces] = 7
    hinted = nystrom_stream.segment(*dumbbell(), 4, hints=painted)
    painted[:] = 0
    assert (hinted.edit([]).labels == hinted.labels).all()
    merged = cut.edit([{"edit": "merge", "at": faces}])
    merged.edits[0]["at"].append(5)
    assert merged.edits[0]["at"] == faces


def test_what_is_asked_for_goes_before_the_file_of_edits(tmp_path):
    # Regression: the next edit, and the file that was saved, went back to the number that the file says.
    mesh = dumbbell(12)
    path, saved = tmp_path / "edits.json", tmp_path / "saved.json"
    nystrom_stream.segment(*mesh, 4).save_edits(path)
    for asked, told in [({"parts": 3}, {"parts": 3}), ({"parts_range": (2, 3)}, {}), ({"detail": 0.5}, {"detail": 0.5})]:
        cut = nystrom_stream.segment(*mesh, edits=path, **asked)
        edited = cut.edit([{"edit": "name", "at": cut.place(0), "name": "x"}])
        assert (edited.labels == cut.labels).all()
        edited.save_edits(saved)
        assert {key: value for key, value in json.loads(saved.read_text()).items() if key in ("parts", "detail")} == told
    # A file that is given later still has its number.
    assert cut.edit(path).n_parts == 4


def test_a_place_is_farthest_from_other_parts(cut):
    def rings(triangles, reached):
        """The same ring by ring over all that is left, as slow as plain."""
        reached, left = reached.copy(), np.arange(len(triangles))
        while True:
            near = reached[triangles[left]].any(axis=1)
            if near.all() or not near.any():
                return left
            reached[triangles[left[near]]] = True
            left = left[~near]

    from nystrom_stream._results import farthest

    for part in range(cut.n_parts):
        own = cut.labels == part
        reached = np.zeros(len(cut.vertices), bool)
        reached[cut.triangles[~own]] = True
        assert (farthest(cut.triangles[own], reached.copy()) == rings(cut.triangles[own], reached)).all()
    # Two strips, of which one is beside another part: the other is never reached. Then no other part at all.
    strips = np.array([[0, 1, 2], [1, 2, 3], [4, 5, 6], [5, 6, 7]], np.uint32)
    assert farthest(strips, np.arange(8) == 0).tolist() == [2, 3]
    assert farthest(strips[:2], np.arange(8) == 0).tolist() == [1]
    assert farthest(strips, np.zeros(8, bool)).tolist() == [0, 1, 2, 3]
    assert farthest(strips, np.ones(8, bool)).tolist() == [0, 1, 2, 3]


def test_names_go_along(cut, tmp_path):
    named = pickle.loads(pickle.dumps(cut))
    named.names = {0: "left ball", 2: "bar"}
    assert named.names == ["left ball", "", "bar", ""] and named.report["parts"][2]["name"] == "bar"
    named.names = {0: ""}
    assert named.names == ["", "", "bar", ""] and "name" not in named.report["parts"][0]
    named.names = ["a", "b"]
    assert named.names == ["a", "b", "", ""]
    named.save(tmp_path / "named.ply")
    assert b"comment part 1: b\n" in (tmp_path / "named.ply").read_bytes()[:2000]
    named.save(str(tmp_path / "parts") + "/")
    assert list((tmp_path / "parts").glob("*_b.ply"))
    for names in ({4: "x"}, {0: "two\nlines"}, {0: 7}):
        with pytest.raises(ValueError, match="names: "):
            named.names = names
    table = tmp_path / "names.tsv"
    table.write_text("part\tname\n3\tright ball\n")
    assert nystrom_stream.segment(*dumbbell(), 4, names=table).names[3] == "right ball"
    # Regression: a table removed the names that edits gave; the program adds to them.
    edits = [{"edit": "name", "at": cut.place(1), "name": "bar"}]
    both = nystrom_stream.segment(*dumbbell(), 4, edits=edits, names=table)
    assert "bar" in both.names and both.names[3] == "right ball"
    named.names = table
    assert named.names == ["a", "b", "", "right ball"]
    trimesh = pytest.importorskip("trimesh", exc_type=ImportError)
    assert isinstance(named.to_trimesh(), trimesh.Trimesh) and named.to_trimesh().metadata["part_names"][1] == "b"


def test_a_work_dir_makes_edits_quick(tmp_path):
    mesh = dumbbell(60)
    cut = nystrom_stream.segment(*mesh, 4, work_dir=tmp_path / "work")
    edited = cut.edit([{"edit": "split", "at": cut.place(1)}])
    assert "rows" in cut.report["seconds"] and "rows" not in edited.report["seconds"] and edited.n_parts == 5
    assert (edited.labels == nystrom_stream.segment(*mesh, 4, edits=edited.edits).labels).all()


def test_edits_start_from_another_number_of_parts(cut):
    three = cut.cut(3)
    edited = three.edit([{"edit": "split", "at": three.place(0), "into": 2}])
    assert edited.n_parts == 4 and agree(cut.edit([]).labels, cut.labels)


def test_the_page_corrects_parts(cut, tmp_path):
    def told(cut):
        cut.save(tmp_path / "page.html")
        text = (tmp_path / "page.html").read_text()
        start = text.index('type="application/json">') + 24
        return json.loads(text[start : text.index("</script>", start)])

    page = told(cut)
    assert page["cuts"]["model"]["unions"] and page["edits"] is None
    edited = cut.edit([{"edit": "name", "at": cut.place(1), "name": "ball"}])
    for each in (edited, pickle.loads(pickle.dumps(edited))):
        page = told(each)
        assert page["edits"]["edits"] == edited.edits and "ball" in page["names"] and page["cuts"]["model"]
    assert told(cut.cut(3))["cuts"]["model"]
    # Regression: the page of another number of parts saved edits, and showed a command, of the cut that it was taken from.
    assert told(cut.cut(3))["report"]["options"]["parts"]["count"] == {"exactly": 3}


def test_edits_of_a_cut_within_a_range_state_its_parts(tmp_path):
    # Regression: a saved file stated none, so that the program applied the edits to the parts that it finds by itself.
    ranged = nystrom_stream.segment(*dumbbell(), parts_range=(6, 7))
    edited = ranged.edit([{"edit": "split", "at": ranged.place(0), "into": 2}])
    edited = edited.edit([{"edit": "name", "at": ranged.place(1), "name": "x"}])
    for cut in (ranged, edited):
        cut.save_edits(tmp_path / "edits.json")
        assert json.loads((tmp_path / "edits.json").read_text())["parts"] == ranged.n_parts >= 6
    assert (nystrom_stream.segment(*dumbbell(), edits=tmp_path / "edits.json").labels == edited.labels).all()


def test_wrong_edits_are_named(cut):
    a = cut.place(0)
    for edits, said in [
        ([{"edit": "merge", "at": [a]}], r"edit 1 \(merge\): .*two places"),
        ([{"edit": "split", "at": a}, {"edit": "paint", "at": a}], r"edit 2 \(paint\)"),
        ([{"edit": "split", "at": [90, 0, 0]}], r"edit 1 \(split\): .*away from the mesh"),
        ([{"edit": "split", "at": 10**7}], "there is no face"),
        ({"format": "x", "edits": []}, "format"),
        # Regression: of these the JSON between Python and the library was complained of, without a name.
        ([{"edit": "split", "at": np.array([np.nan, 0, 0])}], "^edits: Out of range float"),
        ({"edits": [], "parts": 0}, "^parts: 0 is too small"),
        ({"edits": [], "detail": np.inf}, "^detail: inf is not a finite number"),
    ]:
        with pytest.raises(ValueError, match=said) as wrong:
            cut.edit(edits)
        assert "--" not in str(wrong.value)
    for edits in ("split", [7]):
        with pytest.raises((TypeError, FileNotFoundError)):
            cut.edit(edits)
    with pytest.raises(TypeError, match="^parts: 'x' is not a whole number"):
        cut.edit({"edits": [], "parts": "x"})
    with pytest.raises(TypeError, match="neither a place"):
        cut.edit([{"edit": "split", "at": {1, 2}}])
    with pytest.raises(ValueError, match="cluster='parts'"):
        nystrom_stream.segment(*dumbbell(), 3, cluster="kmeans", landmarks=12, edits=[])
    means = nystrom_stream.segment(*dumbbell(), 3, cluster="kmeans", landmarks=12)
    with pytest.raises(ValueError, match="cluster='parts'"):
        means.edit([{"edit": "split", "at": a}])


def test_files_of_other_programs_are_edits_and_doubled_fields_are_not(cut, tmp_path):
    # Regression: a byte order mark was refused, and of two fields of a name the last was taken in silence.
    path = tmp_path / "edits.json"
    text = '{"format": "nystrom-stream edits", "version": 1.0, "edits": [{"into": 2.0, "at": 5.0, "edit": "split"}]}'
    path.write_text(text, encoding="utf-8-sig")
    assert (cut.edit(path).labels == cut.edit({"edit": "split", "at": 5}).labels).all()
    path.write_text(text.replace('"at": 5.0', '"at": 5, "at": 6'))
    with pytest.raises(ValueError, match="edits.json: not a file of edits: duplicate field `at`"):
        cut.edit(path)
    # Regression: the message did not say of what.
    with pytest.raises(TypeError, match="^edits: keys must be str"):
        cut.edit({"edit": "split", "at": 5, (1, 2): 3})
    with pytest.raises(TypeError, match="^edits: a complex is neither a place"):
        cut.edit({"edit": "split", "at": 1j})


def test_names_have_no_letter_that_cannot_be_written(cut):
    # Regression: a half of a surrogate pair failed when it was saved, and control characters beyond ASCII were accepted.
    for name in ("a\nb", "\x7f", "a\x85b", "\ud800"):
        with pytest.raises(ValueError, match="names: .* is not a line of text"):
            cut.names = {0: name}
