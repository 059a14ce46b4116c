// What PCL makes of depth images: NARF borders, complete interest image, keypoints, descriptors. One thread.
// usage: narf_oracle IMAGES ANSWERS
//
// IMAGES, little endian, until the file ends: int32 height, width; float32 fx, fy, cx, cy, support size in m;
// float32 depth[height][width] in m, 0 = none.
// ANSWERS, for each image, planes of [height][width]: float32 border scores left, right, top, bottom as first computed;
// the same four as they stand after the search for shadows; int32 bits of the border traits; float32 surface change;
// float32 its direction x, y, z; float32 interest, complete; float32 interest as PCL computes it unless told, sparse.
// Then int32 n and, n times, float32 x, y, z, interest of a keypoint of the complete image, int32 whether it has a
// descriptor, float32 descriptor[36]; int32 m and, m times, float32 x, y, z, interest of a keypoint of the sparse image.
// Last, float32 ms: all of this but the sparse image and the files.
#include <pcl/features/narf.h>
#include <pcl/features/range_image_border_extractor.h>
#include <pcl/keypoints/narf_keypoint.h>
#include <pcl/range_image/range_image_planar.h>

#include <chrono>
#include <cstdint>
#include <fstream>
#include <iostream>
#include <vector>

namespace {

constexpr int kBeams = 36;

template <typename T>
bool read(std::ifstream& file, T* values, std::size_t count) {
  return static_cast<bool>(file.read(reinterpret_cast<char*>(values), sizeof(T) * count));
}

template <typename T>
void write(std::ofstream& file, const T* values, std::size_t count) {
  file.write(reinterpret_cast<const char*>(values), sizeof(T) * count);
}

void write_count(const pcl::PointCloud<pcl::InterestPoint>& points, std::ofstream& out) {
  const auto count = static_cast<std::int32_t>(points.size());
  write(out, &count, 1);
}

void write_point(const pcl::InterestPoint& point, std::ofstream& out) {
  const float numbers[4] = {point.x, point.y, point.z, point.strength};
  write(out, numbers, 4);
}

class Stopwatch {
 public:
  void start() { started_ = std::chrono::steady_clock::now(); }
  void stop() { total_ += std::chrono::steady_clock::now() - started_; }
  float ms() const { return std::chrono::duration<float, std::milli>(total_).count(); }

 private:
  std::chrono::steady_clock::time_point started_;
  std::chrono::steady_clock::duration total_{};
};

void answer(const pcl::RangeImagePlanar& image, float support, Stopwatch& watch, std::ofstream& out) {
  const std::size_t size = image.size();
  pcl::RangeImageBorderExtractor borders;
  borders.setRangeImage(&image);
  const auto write_scores = [&] {
    for (const float* scores : {borders.getBorderScoresLeft(), borders.getBorderScoresRight(),
                                borders.getBorderScoresTop(), borders.getBorderScoresBottom()})
      write(out, scores, size);
  };
  watch.start();
  borders.getBorderScoresLeft();
  watch.stop();
  write_scores();
  watch.start();
  const auto& described = borders.getBorderDescriptions();
  watch.stop();
  write_scores();
  std::vector<std::int32_t> traits(size);
  for (std::size_t k = 0; k < size; ++k) traits[k] = static_cast<std::int32_t>(described[k].traits.to_ulong());
  write(out, traits.data(), size);

  watch.start();
  const float* change = borders.getSurfaceChangeScores();
  const Eigen::Vector3f* directions = borders.getSurfaceChangeDirections();
  watch.stop();
  write(out, change, size);
  std::vector<float> plane(size);
  for (int axis = 0; axis < 3; ++axis) {
    for (std::size_t k = 0; k < size; ++k) plane[k] = directions[k][axis];
    write(out, plane.data(), size);
  }

  pcl::NarfKeypoint keypoints(&borders, support);
  keypoints.getParameters().calculate_sparse_interest_image = false;
  watch.start();
  const float* interest = keypoints.getInterestImage();
  const auto& points = keypoints.getInterestPoints();
  watch.stop();
  write(out, interest, size);
  pcl::NarfKeypoint sparse(&borders, support);
  write(out, sparse.getInterestImage(), size);

  write_count(points, out);
  for (const auto& point : points) {
    pcl::Narf narf;
    watch.start();
    const std::int32_t described_too = narf.extractFromRangeImage(image, point.getVector3fMap(), kBeams, support);
    watch.stop();
    write_point(point, out);
    write(out, &described_too, 1);
    const std::vector<float> none(kBeams, 0.0f);
    write(out, described_too ? narf.getDescriptor() : none.data(), kBeams);
  }
  write_count(sparse.getInterestPoints(), out);
  for (const auto& point : sparse.getInterestPoints()) write_point(point, out);
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 3) {
    std::cerr << "usage: narf_oracle IMAGES ANSWERS\n";
    return 2;
  }
  std::ifstream in(argv[1], std::ios::binary);
  std::ofstream out(argv[2], std::ios::binary);
  std::int32_t shape[2];
  while (read(in, shape, 2)) {
    float optics[5];
    std::vector<float> depth(static_cast<std::size_t>(shape[0]) * shape[1]);
    if (!read(in, optics, 5) || !read(in, depth.data(), depth.size())) {
      std::cerr << "the images end in the middle of one\n";
      return 1;
    }
    Stopwatch watch;
    pcl::RangeImagePlanar image;
    watch.start();
    image.setDepthImage(depth.data(), shape[1], shape[0], optics[2], optics[3], optics[0], optics[1]);
    watch.stop();
    answer(image, optics[4], watch, out);
    const float ms = watch.ms();
    write(out, &ms, 1);
  }
  return out ? 0 : 1;
}
