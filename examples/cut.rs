//! Cuts a mesh file into parts, prints their sizes and saves the labelled mesh.
//!
//! `cargo run --release --example cut -- mesh.ply [PARTS] [OUT]`

use nystrom_stream::{Mesh, Result, Segmenter};

fn cut(path: &str, parts: Option<usize>, out: Option<&str>) -> Result<()> {
    let mesh = Mesh::open(path)?;
    let segmenter = parts.into_iter().fold(Segmenter::new(), Segmenter::parts);
    let cut = segmenter.run(&mesh)?;
    for part in &cut.report().parts {
        println!("part {:3}: {:10} faces, area {:.4}", part.label, part.faces, part.area);
    }
    out.map_or(Ok(()), |out| cut.save(out))
}

fn main() -> std::process::ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [path, rest @ ..] = &arguments[..] else {
        eprintln!("usage: cut MESH [PARTS] [OUT]");
        return 2.into();
    };
    let parts = match rest.first().map(|parts| parts.parse()).transpose() {
        Ok(parts) => parts,
        Err(error) => {
            eprintln!("PARTS: {error}");
            return 2.into();
        }
    };
    match cut(path, parts, rest.get(1).map(String::as_str)) {
        Ok(()) => 0.into(),
        Err(error) => {
            eprintln!("{error}");
            1.into()
        }
    }
}
