//! Methods of [`Mesh`] that need the layers above it: an example mesh of any size, and labelled files in every format.

use crate::apps::creature::{Creature, Options};
use crate::apps::export::form::{Form, SaveOptions, unknown};
use crate::base::printable::counted;
use crate::base::{Error, Result};
use crate::mesh::geometry::{MOST_CORNERS, MOST_FACES};
use crate::mesh::ply::labelled::REPEATED;
use crate::mesh::{Labelling, Mesh};
use crate::pipeline::admission::admit;
use crate::pipeline::input;
use crate::store::manifest::checksum_within;
use crate::store::{Context, Run, WorkDir};
use serde_json::{Value, json};
use std::path::Path;

impl Mesh {
    /// A four-legged animal with at least `faces` faces, 3,528 or more: a mesh for trying things, held in memory, 18
    /// bytes per face. See [`crate::apps::creature`].
    ///
    /// ```
    /// # fn main() -> nystrom_stream::Result<()> {
    /// assert!(nystrom_stream::Mesh::creature(2_000)?.faces.len() >= 2_000);
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// [`Error::Parameter`] for more faces than can be numbered.
    pub fn creature(faces: u64) -> Result<Self> {
        let most = MOST_FACES.min(MOST_CORNERS / 3);
        let refused = || {
            let problem = format!("{faces} faces are more than can be numbered");
            Error::parameter("faces", problem, format!("request at most {}", most / 100 * 99))
        };
        if faces > most {
            return Err(refused());
        }
        let creature = Creature::new(&Options { faces, ..Options::default() })?;
        if creature.face_count() > most {
            return Err(refused());
        }
        let positions = (0..creature.vertex_count()).map(|v| creature.position(v)).collect();
        let faces = (0..creature.face_count()).map(|f| creature.face(f)).collect();
        Self::from_vecs(positions, faces)
    }

    /// Writes the mesh with labels in the format given by the extension of `path`: `.ply` (the content of the file,
    /// with labels, colours and qualities of the faces), `.seg` (one label per line), `.npy` (labels), `.obj` (one
    /// group per part), `.glb`, or a folder with one PLY per part if `path` ends with `/`; `.png` with the feature
    /// `pictures`, `.parquet` with `parquet`.
    ///
    /// ```
    /// # fn main() -> nystrom_stream::Result<()> {
    /// use nystrom_stream::{Labelling, Mesh};
    /// # let dir = tempfile::tempdir().unwrap();
    /// # let path = dir.path().join("labels.seg");
    /// let corners = [[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.]];
    /// let mesh = Mesh::from_slices(&corners, &[[0, 1, 2], [0, 2, 3]])?;
    /// let colours = [[255, 0, 0], [0, 0, 255]];
    /// mesh.save(&path, Labelling { labels: &[0, 1], colours: &colours, quality: None, names: &[], fine: None })?;
    /// assert_eq!(std::fs::read_to_string(&path).unwrap(), "0\n1\n");
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// # Errors
    /// [`Error::Parameter`] for an unknown file extension, labels or qualities that do not match the faces, fewer
    /// colours than parts (unless there are none), names of parts that do not exist, labels that the format cannot hold
    /// (beyond `i32` in a `.ply`, 65,536 parts or more in an `.obj`, a `.glb` or a folder); [`Error::Memory`];
    /// [`Error::Io`].
    pub fn save(&self, path: impl AsRef<Path>, labelling: Labelling<'_>) -> Result<()> {
        self.save_with(path, labelling, &SaveOptions::default())
    }

    /// The same with options. A folder's `parts.json` states for each part whether `cap` made it a solid.
    ///
    /// # Errors
    /// As [`Mesh::save`]; [`Error::Parameter`] for options that do not apply to the format.
    pub fn save_with(&self, path: impl AsRef<Path>, labelling: Labelling<'_>, options: &SaveOptions) -> Result<()> {
        self.save_under(path, labelling, options, &Run::new(&()))
    }

    /// The same under `run`, which can cancel it.
    ///
    /// # Errors
    /// As [`Mesh::save_with`]; [`Error::Cancelled`].
    pub fn save_under(
        &self,
        path: impl AsRef<Path>,
        labelling: Labelling<'_>,
        options: &SaveOptions,
        run: &Run,
    ) -> Result<()> {
        let path = path.as_ref();
        let form = Form::of(path);
        options.check(form)?;
        checked(self)?;
        labelling.fit(self.faces.len())?;
        named_and_coloured(&labelling)?;
        form.ok_or_else(|| unknown(path))?.write(path, Some(self), &labelling, options, run)
    }
}

/// Rejects too few colours for the labels, unless there are none at all, and names of parts that have neither a colour
/// nor faces: both belong to another labelling.
fn named_and_coloured(labelling: &Labelling<'_>) -> Result<()> {
    let Labelling { labels, colours, names, .. } = labelling;
    let parts = labels.iter().max().map_or(0, |&label| label as usize + 1);
    if !colours.is_empty() && colours.len() < parts && colours.len() != REPEATED {
        let problem = format!("{} for labels up to {}", colours.len(), parts - 1);
        return Err(Error::parameter("colours", problem, "give one per part, or none"));
    }
    if names.len() > parts.max(colours.len()) {
        let problem = format!("{} for {}", names.len(), counted(parts.max(colours.len()), "part"));
        return Err(Error::parameter("names", problem, "give one per part, empty for none"));
    }
    Ok(())
}

/// Rejects a mesh that its caller put together wrongly ([`Mesh::new`]). Readers have checked what they read.
pub(super) fn checked(mesh: &Mesh) -> Result<()> {
    if mesh.document().is_none() || mesh.faces.is_empty() { mesh.check() } else { Ok(()) }
}

/// The identity of the [`checked`] `mesh` for the work directory of `context`. A work directory of another mesh is
/// refused, or emptied with `force`.
pub(super) fn admitted(mesh: &Mesh, force: bool, context: Context<'_>) -> Result<Value> {
    let identity = identity(mesh, context.work, |path| input::identity_in(path, context.work))?;
    admit(mesh.path(), &identity, force, context)?;
    mesh.notes().iter().for_each(|note| context.run.progress.note(note));
    Ok(identity)
}

/// The identity of `mesh` for `work`: that of a file by `of_file`, that of arrays by a hash of their content. Null in a
/// temporary directory, where it would be computed in vain.
pub(super) fn identity(mesh: &Mesh, work: &WorkDir, of_file: impl FnOnce(&Path) -> Result<Value>) -> Result<Value> {
    match mesh.document() {
        _ if work.is_temporary() => Ok(Value::Null),
        Some(document) if mesh.path().is_file() => {
            let identity = of_file(mesh.path())?;
            // Another file may be at that path by now.
            if document.is_file() && identity["whole"] != checksum_within(document.bytes(), &work.cancel)? {
                let problem = "has changed since it was opened";
                return Err(Error::malformed(mesh.path(), "file", problem, "open it again"));
            }
            Ok(identity)
        }
        _ => Ok(json!({"content": format!("{:016x}", mesh.content_hash(&work.cancel)?)})),
    }
}
