//! Pictures of small shapes: what is seen where, whatever the threads.

use nystrom_stream::apps::colours::colours_for;
use nystrom_stream::apps::picture::{Image, PictureParams, Up, render};
use nystrom_stream::mesh::Mesh;
use nystrom_stream::store::Run;

const RED: [u8; 3] = [220, 0, 0];
const GREEN: [u8; 3] = [0, 160, 0];
const BLUE: [u8; 3] = [0, 0, 220];

/// A cube of quadrangles, its faces in the order -z +z -y +y -x +x.
fn cube(high: f64) -> Mesh {
    let vertices: Vec<[f64; 3]> =
        (0..8).map(|k| [f64::from(k & 1), f64::from(k >> 1 & 1) * high, f64::from(k >> 2)]).collect();
    let faces: [[u32; 4]; 6] = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    Mesh::from_slices(&vertices, &faces).unwrap()
}

fn small() -> PictureParams {
    PictureParams::default().width(120).height(100).legend(false)
}

/// Pixels nearer to `colour` in hue than to grey.
fn count(image: &Image, colour: [u8; 3]) -> usize {
    let strongest = (0..3).max_by_key(|&k| colour[k]).unwrap();
    let like = |p: &&[u8; 4]| (0..3).all(|k| k == strongest || i32::from(p[strongest]) > i32::from(p[k]) + 40);
    image.pixels.iter().filter(like).count()
}

#[test]
fn three_sides_of_a_cube_are_seen_and_the_hidden_ones_are_not() {
    let mesh = cube(1.0);
    // Top green, bottom blue, sides red.
    let params = small().up(Some("y".parse().unwrap())).lines(false);
    let image = render(&mesh, Some(&[0, 0, 2, 1, 0, 0]), &[RED, GREEN, BLUE], &params, &Run::new(&())).unwrap();
    assert_eq!(image.pixels[0], [255; 4]);
    assert!(count(&image, RED) > 1000, "{}", count(&image, RED));
    assert!(count(&image, GREEN) > 100, "{}", count(&image, GREEN));
    assert_eq!(count(&image, BLUE), 0);
    // Up is up: green above red.
    let row = |colour| {
        let rows = image.pixels.chunks(image.width).enumerate();
        let of = |(y, row): (usize, &[[u8; 4]])| {
            y * count(&Image { width: image.width, height: 1, pixels: row.to_vec() }, colour)
        };
        rows.map(of).sum::<usize>() / count(&image, colour).max(1)
    };
    assert!(row(GREEN) + 10 < row(RED));
    let down = params.up(Some("-y".parse().unwrap()));
    let image = render(&mesh, Some(&[0, 0, 2, 1, 0, 0]), &[RED, GREEN, BLUE], &down, &Run::new(&())).unwrap();
    assert_eq!(count(&image, GREEN), 0);
    assert!(count(&image, BLUE) > 100);
}

#[test]
fn the_picture_does_not_depend_on_the_threads() {
    let n = 60u32;
    let vertices: Vec<[f64; 3]> = (0..(n + 1) * (n + 1))
        .map(|v| {
            let (x, y) = (f64::from(v % (n + 1)) / f64::from(n), f64::from(v / (n + 1)) / f64::from(n));
            [x, 0.2 * (9.0 * x).sin() * (7.0 * y).cos(), y]
        })
        .collect();
    let corner = |x: u32, y: u32| y * (n + 1) + x;
    let faces: Vec<[u32; 3]> = (0..n * n)
        .flat_map(|q| {
            let (x, y) = (q % n, q / n);
            let [a, b, c, d] = [corner(x, y), corner(x + 1, y), corner(x + 1, y + 1), corner(x, y + 1)];
            [[a, c, b], [a, d, c]]
        })
        .collect();
    let labels: Vec<u32> = (0..faces.len() as u32).map(|f| f / 2 % n / 20).collect();
    let mesh = Mesh::from_slices(&vertices, &faces).unwrap();
    let draw = |threads| {
        let mut run = Run::new(&());
        run.threads = threads;
        let colours = colours_for(&mesh, &labels, &run).unwrap();
        let params = small().views(3).transparent(true).legend(true).width(400).height(300);
        render(&mesh, Some(&labels), &colours, &params, &run).unwrap()
    };
    let one = draw(1);
    assert!(one.pixels.iter().any(|p| p[3] == 0) && one.pixels.iter().any(|p| p[3] == 255));
    for threads in [2, 5] {
        assert_eq!(one, draw(threads), "{threads} threads");
    }
}

#[test]
fn nothing_is_seen_between_neighbouring_faces() {
    // A disc of slivers around one vertex, looked at from above: no white inside.
    let n = 997u32;
    let mut vertices = vec![[0.0, 0.0, 0.0]];
    vertices.extend((0..n).map(|k| {
        let angle = f64::from(k) / f64::from(n) * std::f64::consts::TAU;
        [angle.cos(), 0.001 * f64::from(k % 2), angle.sin()]
    }));
    let faces: Vec<[u32; 3]> = (0..n).map(|k| [0, 1 + k, 1 + (k + 1) % n]).collect();
    let mesh = Mesh::from_slices(&vertices, &faces).unwrap();
    let params = small().up(Some("y".parse().unwrap())).tilt(90.0).transparent(true).samples(1);
    let image = render(&mesh, None, &[], &params, &Run::new(&())).unwrap();
    for row in image.pixels.chunks(image.width) {
        let covered: Vec<usize> = (0..row.len()).filter(|&x| row[x][3] > 0).collect();
        if let (Some(first), Some(last)) = (covered.first(), covered.last()) {
            assert_eq!(covered.len(), last - first + 1);
        }
    }
}

#[test]
fn odd_meshes_are_drawn_or_refused() {
    let run = Run::new(&());
    // A face without a place in space, one without area, and labels beyond the colours.
    let vertices = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [f64::NAN, 0.0, 0.0], [2.0, 0.0, 0.0]];
    let mesh = Mesh::from_slices(&vertices, &[[0u32, 1, 2], [0, 1, 3], [0, 1, 4]]).unwrap();
    let image = render(&mesh, Some(&[u32::MAX, 0, 7]), &[RED], &small(), &run).unwrap();
    assert!(image.pixels.iter().filter(|p| p[0] < 200).count() > 50);
    // A single point.
    let mesh = Mesh::from_slices(&vertices[..1], &[[0u32, 0, 0]]).unwrap();
    render(&mesh, None, &[], &small(), &run).unwrap();
    // Nothing in space.
    let mesh = Mesh::from_slices(&vertices, &[[0u32, 1, 3]]).unwrap();
    assert!(render(&mesh, None, &[], &small(), &run).is_err());
    let mesh = cube(1.0);
    assert!(render(&mesh, Some(&[0; 5]), &[RED], &small(), &run).is_err());
    for wrong in
        [small().width(0), small().height(1 << 20), small().views(0), small().samples(9), small().turn(f64::NAN)]
    {
        assert!(render(&mesh, None, &[], &wrong, &run).is_err(), "{wrong:?}");
    }
    assert!("w".parse::<Up>().is_err());
}

#[test]
fn neighbours_get_unlike_colours_and_gaps_in_the_numbers_do_no_harm() {
    let mesh = cube(2.0);
    let colours = colours_for(&mesh, &[0, 5, 0, 5, 9, u32::MAX], &Run::new(&())).unwrap();
    assert_eq!(colours.len(), 10);
    assert!(colours[0] != colours[5] && colours[5] != colours[9] && colours[0] != colours[9]);
    assert!(colours_for(&mesh, &[u32::MAX; 6], &Run::new(&())).unwrap().is_empty());
}
