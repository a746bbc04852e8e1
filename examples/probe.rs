use nystrom_stream::*;
use std::time::Instant;
struct P;
impl base::Progress for P { fn end(&self, s:&str, t:f64){ eprintln!("  {s}: {:.1} ms", t*1e3);} }
fn main(){
  let a: Vec<String> = std::env::args().collect();
  let path = std::path::Path::new(&a[1]); let l: usize = a[2].parse().unwrap();
  let mut run = store::Run::new(&P); if let Some(t)=a.get(3){run.threads=t.parse().unwrap();}
  let work = store::WorkDir::temporary(std::path::Path::new("/tmp")).unwrap();
  let t=Instant::now();
  let o = mesh::open::open(path, work.path(), &run).unwrap();
  eprintln!("open {:.1} ms, {} faces", t.elapsed().as_secs_f64()*1e3, o.mesh.faces.len());
  let g = graph::DualGraph::build(&o.mesh, path, &serde_json::json!(1), &work, &run).unwrap();
  eprintln!("{:?}", g.facts);
  for metric in [graph::Metric::default(), graph::Metric::paper()] {
    let w = g.weighted(metric, &work, &run).unwrap();
    let csr=w.csr(); let n=g.nodes.len();
    let mean=distance::front::mean_weight(csr);
    let mut f=distance::Front::new(mean); let mut field=vec![0f32;n];
    for _ in 0..3 { let t=Instant::now(); let v=f.full(csr, 5, &mut field, &run.cancel).unwrap(); let e=t.elapsed().as_secs_f64(); eprintln!("  front {:.1} ms {:.1} ns/face pops/n {:.3} exp/n {:.3} bytes {}", e*1e3, e*1e9/n as f64, v.popped as f64/n as f64, v.expanded as f64/n as f64, f.bytes()); }
    let t=Instant::now(); let o=distance::oracle::dijkstra(csr,5); eprintln!("  oracle {:.1} ms equal {}", t.elapsed().as_secs_f64()*1e3, o==field);
    let r=distance::DistanceRows::build(&w,&g.nodes,distance::rows::RowParams{l,sampling:Default::default()},&work,&run).unwrap();
    eprintln!("  mean {} landmarks {:?}", r.mean(), &r.landmarks[..r.len().min(5)]);
  }
}
