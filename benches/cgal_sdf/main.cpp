// CGAL's shape-diameter segmentation with its defaults, as a user would call it: the peer that
// `segment` is timed against. Reads PLY or OFF, writes one label a face a line.
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Surface_mesh.h>
#include <CGAL/boost/graph/IO/polygon_mesh_io.h>
#include <CGAL/mesh_segmentation.h>

#include <chrono>
#include <cstdio>
#include <fstream>
#include <string>

using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
using Mesh = CGAL::Surface_mesh<Kernel::Point_3>;
using Face = Mesh::Face_index;

static double now()
{
  const auto time = std::chrono::steady_clock::now().time_since_epoch();
  return std::chrono::duration<double>(time).count();
}

int main(int argc, char** argv)
{
  if (argc < 3) {
    std::fprintf(stderr, "usage: cgal_sdf MESH LABELS.seg [CLUSTERS=5] [SMOOTHING=0.26]\n");
    return 2;
  }
  const std::size_t clusters = argc > 3 ? std::stoul(argv[3]) : 5;
  const double smoothing = argc > 4 ? std::stod(argv[4]) : 0.26;

  Mesh mesh;
  if (!CGAL::IO::read_polygon_mesh(argv[1], mesh) || mesh.is_empty() || !CGAL::is_triangle_mesh(mesh)) {
    std::fprintf(stderr, "%s: not a triangle mesh that CGAL can hold\n", argv[1]);
    return 1;
  }
  auto values = mesh.add_property_map<Face, double>("f:sdf").first;
  auto labels = mesh.add_property_map<Face, std::size_t>("f:label").first;

  const double start = now();
  CGAL::sdf_values(mesh, values);
  const double middle = now();
  const std::size_t parts = CGAL::segmentation_from_sdf_values(mesh, values, labels, clusters, smoothing);
  const double end = now();

  std::ofstream out(argv[2]);
  for (const Face face : mesh.faces())
    out << labels[face] << '\n';
  std::printf("%s\t%zu faces\t%zu parts\tsdf %.3f s\tsegmentation %.3f s\ttotal %.3f s\n", argv[1],
              std::size_t(mesh.number_of_faces()), parts, middle - start, end - middle, end - start);
  return out.flush() ? 0 : 1;
}
