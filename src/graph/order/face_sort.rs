//! Sorts faces along the curve: each by the least of its corners' new numbers.
//!
//! New vertex numbers reach the faces by random access if the ranks fit memory, else by two shuffles: corners go to
//! their vertices' buckets, get the new numbers there, and return to their faces. An external sort by (least number,
//! old face) then gives faces in curve order with renumbered corners, and the order itself. Disk: 20 B per triangle (16
//! B per corner of other polygons), 40 B more without random access; written and read once, and only what memory does
//! not hold.

use crate::base::Result;
use crate::base::parallel::{chunk_count, chunk_range};
use crate::mesh::Faces;
use crate::store::npy::ArrayWriter;
use crate::store::shuffle::{BudgetedShuffle, Producer, RangeBuckets, Shuffle, Splitters};
use crate::store::{Context, MappedSlice, WorkDir};

const CHUNK: usize = 1 << 14;
/// The order itself: the face of the file at each position (u32, n).
pub(super) const ORDER: &str = "face_order.npy";
const TRIANGLES: &str = "curve_triangles.npy";
const STARTS: &str = "curve_starts.npy";
const CORNERS: &str = "curve_corners.npy";

/// The files that [`sort`] writes for faces like `faces`.
pub(super) fn files(faces: &Faces) -> &'static [&'static str] {
    match faces {
        Faces::Triangles { .. } => &[TRIANGLES],
        Faces::Polygons { .. } => &[STARTS, CORNERS],
    }
}

/// Opens the sorted faces of an earlier run over `faces`, whose corner indices are below `vertices`.
pub(super) fn open(faces: &Faces, vertices: usize, work: &WorkDir) -> Result<Faces> {
    match faces {
        Faces::Triangles { len, .. } => {
            work.indices::<u32>(TRIANGLES, 3 * len, vertices)?;
            let (bytes, start) = work.array_bytes(TRIANGLES)?;
            Faces::triangles(&work.place(TRIANGLES), bytes, start, 12, *len)
        }
        Faces::Polygons { corners, .. } => Ok(Faces::Polygons {
            starts: work.starts(STARTS, faces.len(), corners.len())?,
            corners: work.indices(CORNERS, corners.len(), vertices)?,
        }),
    }
}

/// Sorts `faces`; `rank[v]` is the new number of vertex v.
pub(super) fn sort(faces: &Faces, rank: &MappedSlice<u32>, in_memory: bool, context: Context<'_>) -> Result<()> {
    let job = FaceSort { faces, rank, in_memory, context };
    match faces {
        Faces::Triangles { len, .. } => {
            let push = |key: u32, face: u32, corners: &[u32], push: &mut dyn FnMut([u32; 5]) -> Result<()>| {
                push([key, face, corners[0], corners[1], corners[2]])
            };
            let mut out: ArrayWriter<u32> = context.work.writer(TRIANGLES, 3)?;
            job.sort(*len as u64, push, |records, order| {
                order.extend(records.iter().map(|record| record[1]));
                records.iter().try_for_each(|record| out.push(&record[2..]))
            })?;
            out.finish(false)?;
        }
        Faces::Polygons { corners, .. } => {
            // One record per corner, and one for a face without corners.
            let push = |key: u32, face: u32, corners: &[u32], push: &mut dyn FnMut([u32; 4]) -> Result<()>| {
                if corners.is_empty() {
                    return push([key, face, u32::MAX, 0]);
                }
                corners.iter().enumerate().try_for_each(|(slot, &corner)| push([key, face, slot as u32, corner]))
            };
            let (mut starts, mut out) =
                (context.work.writer::<u64>(STARTS, 1)?, context.work.writer::<u32>(CORNERS, 1)?);
            let mut end = 0u64;
            starts.push(&[0])?;
            job.sort((faces.len() + corners.len()) as u64, push, |records, order| {
                for face in records.chunk_by(|a, b| a[1] == b[1]) {
                    order.push(face[0][1]);
                    for record in face.iter().filter(|record| record[2] != u32::MAX) {
                        out.push(&record[3..])?;
                        end += 1;
                    }
                    starts.push(&[end])?;
                }
                Ok(())
            })?;
            starts.finish(false)?;
            out.finish(false)?;
        }
    }
    Ok(())
}

struct FaceSort<'a> {
    faces: &'a Faces,
    rank: &'a MappedSlice<u32>,
    in_memory: bool,
    context: Context<'a>,
}

/// The sort key of a face, from its corners' new numbers.
fn key(corners: &[u32]) -> u32 {
    corners.iter().copied().min().unwrap_or(u32::MAX)
}

impl FaceSort<'_> {
    /// Sorts records of W words, which begin with key and face. `push(key, face, corners, out)` makes a face's records;
    /// `write(records, order)` receives them sorted, in whole faces, and appends the faces to `order`.
    fn sort<const W: usize>(
        &self,
        records: u64,
        push: impl Fn(u32, u32, &[u32], &mut dyn FnMut([u32; W]) -> Result<()>) -> Result<()> + Sync,
        mut write: impl FnMut(&[[u32; W]], &mut Vec<u32>) -> Result<()>,
    ) -> Result<()> {
        let (Context { work, run }, n) = (self.context, self.faces.len());
        let copies = 6 * run.threads as u64;
        let sorting =
            BudgetedShuffle::<[u32; W]>::new(work.spill("faces.tmp"), "sorting faces", records, copies, 3, run)?;
        let shuffle = &sorting.shuffle;
        let step = (n / (shuffle.buckets() * Splitters::<2>::SAMPLES)).max(1);
        let sample = (0..n).step_by(step).map(|face| {
            self.faces.with(face, |corners| {
                let least = corners.iter().map(|&v| self.rank[v as usize]).min();
                [least.unwrap_or(u32::MAX), face as u32]
            })
        });
        let splitters = Splitters::new(sample.collect(), shuffle.buckets());
        let send = |face: usize, corners: &[u32], out: &mut Producer<'_, [u32; W]>| {
            let key = key(corners);
            let bucket = splitters.bucket([key, face as u32]);
            push(key, face as u32, corners, &mut |record| out.push(bucket, record))
        };
        if self.in_memory {
            self.look_up(&sorting, &send)?
        } else {
            self.join(&sorting, &send)?
        }
        let mut order: ArrayWriter<u32> = work.writer(ORDER, 1)?;
        let mut block = Vec::with_capacity(CHUNK);
        shuffle.sorted(run, |records| {
            block.clear();
            write(&records, &mut block)?;
            run.progress.advance("order", block.len() as u64);
            order.push(&block)
        })?;
        order.finish(false).map(drop)
    }

    /// Looks up ranks by random access.
    fn look_up<const W: usize>(
        &self,
        sorting: &BudgetedShuffle<[u32; W]>,
        send: &(impl Fn(usize, &[u32], &mut Producer<'_, [u32; W]>) -> Result<()> + Sync),
    ) -> Result<()> {
        let (rank, n) = (&self.rank[..], self.faces.len());
        self.context.run.each_chunk(
            chunk_count(n, CHUNK),
            || (sorting.shuffle.producer(), Vec::new()),
            |k, (out, new)| {
                self.faces.try_for_each(chunk_range(n, CHUNK, k), |face, corners| {
                    new.clear();
                    new.extend(corners.iter().map(|&v| rank[v as usize]));
                    send(face, new, out)
                })
            },
            |(out, _)| out.finish(),
        )
    }

    /// Looks up ranks by two shuffles: to the vertices, and back to the faces.
    fn join<const W: usize>(
        &self,
        sorting: &BudgetedShuffle<[u32; W]>,
        send: &(impl Fn(usize, &[u32], &mut Producer<'_, [u32; W]>) -> Result<()> + Sync),
    ) -> Result<()> {
        let (run, corners) = (self.context.run, self.faces.corner_count() as u64);
        let file = self.context.work.spill("ranked.tmp");
        let ranked = BudgetedShuffle::<[u32; 2]>::new(file, "ranking corners", corners, run.threads as u64, 2, run)?;
        let ranked = &ranked.shuffle;
        let by_face = RangeBuckets::new(self.faces.len(), ranked.buckets());
        self.rank_corners(ranked, by_face)?;
        run.each_chunk(
            ranked.buckets(),
            || (sorting.shuffle.producer(), Vec::new()),
            |bucket, (out, new)| {
                let range = by_face.range(bucket);
                if range.is_empty() {
                    return Ok(());
                }
                let start = self.faces.corner_range(range.start).start;
                new.clear();
                new.resize(self.faces.corner_range(range.end - 1).end - start, 0u32);
                ranked.take(bucket)?.into_iter().for_each(|[corner, rank]| new[corner as usize - start] = rank);
                range.into_iter().try_for_each(|face| {
                    let span = self.faces.corner_range(face);
                    send(face, &new[span.start - start..span.end - start], out)
                })
            },
            |(out, _)| out.finish(),
        )
    }

    /// Sends the new numbers of all corners to their faces: `ranked` receives pairs of corner and number.
    fn rank_corners(&self, ranked: &Shuffle<[u32; 2]>, by_face: RangeBuckets) -> Result<()> {
        let (run, n, total) = (self.context.run, self.faces.len(), self.faces.corner_count() as u64);
        let file = self.context.work.spill("corners.tmp");
        let corners = BudgetedShuffle::<[u32; 2]>::new(file, "sorting corners", total, run.threads as u64, 1, run)?;
        let corners = &corners.shuffle;
        let by_vertex = RangeBuckets::new(self.rank.len(), corners.buckets());
        run.each_chunk(
            chunk_count(n, CHUNK),
            || corners.producer(),
            |k, out| {
                self.faces.try_for_each(chunk_range(n, CHUNK, k), |face, corners| {
                    let start = self.faces.corner_range(face).start as u32;
                    (start..).zip(corners).try_for_each(|(corner, &v)| out.push(by_vertex.bucket_of(v), [v, corner]))
                })
            },
            Producer::finish,
        )?;
        run.each_chunk(
            corners.buckets(),
            || ranked.producer(),
            |bucket, out| {
                corners.take(bucket)?.into_iter().try_for_each(|[v, corner]| {
                    let face = self.faces.face_of_corner(corner as usize) as u32;
                    out.push(by_face.bucket_of(face), [corner, self.rank[v as usize]])
                })
            },
            Producer::finish,
        )
    }
}
