// Several callers at once that share what queries share: an index, a forest, a map's clouds.
#include <cstdint>
#include <thread>

#include "likelihood/gicp.h"
#include "likelihood/point_index.h"
#include "likelihood/surface.h"
#include "likelihood/visibility.h"
#include "proposals/matching/knn.h"
#include "proposals/matching/random_forest.h"
#include "proposals/pose/consensus.h"
#include "proposals/pose/prosac.h"
#include "tests/check.h"

namespace segloc {
namespace {

constexpr std::size_t kPoints = 3000, kDim = 7, kRows = 2000, kQueries = 20, kColumns = 10;
constexpr double kIdentity[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};

std::vector<float> walls() {
  auto points = random_floats(3 * kPoints, -8.0f, 8.0f, 7);
  for (std::size_t i = 0; i < kPoints; ++i) points[3 * i + i % 3] = -8.0f;
  return points;
}

// What one map holds, and queries of it.
class Shared {
 public:
  std::vector<double> answers(int threads) const {
    std::vector<double> all;
    search(threads, all);
    classify(threads, all);
    verify(threads, all);
    vote(threads, all);
    return all;
  }

 private:
  void search(int threads, std::vector<double>& all) const {
    std::vector<int64_t> indices(kQueries * kColumns);
    std::vector<float> distances(indices.size());
    index_.search(queries_.data(), kQueries, kColumns, 3, threads, indices.data(),
                  distances.data());
    all.insert(all.end(), indices.begin(), indices.end());
    all.insert(all.end(), distances.begin(), distances.end());
  }

  void classify(int threads, std::vector<double>& all) const {
    std::vector<int64_t> rows(kRows), columns(kRows);
    for (std::size_t i = 0; i < kRows; ++i) {
      rows[i] = int64_t(i % kQueries);
      columns[i] = int64_t(i);
    }
    const PairTask task = {queries_.data(), vectors_.data(), kDim,
                           rows.data(),     columns.data(),  kRows};
    std::vector<float> scores(kRows);
    forest_.predict_pairs(task, {1, true, 2}, threads, scores.data());
    all.insert(all.end(), scores.begin(), scores.end());
  }

  // The surface finds its normals when they are first needed, by whoever needs them.
  void verify(int threads, std::vector<double>& all) const {
    Rigid start;
    start.t = {0.2, -0.1, 0.15};
    const GicpResult aligned = align(surface_, surface_, start, {}, threads);
    all.insert(all.end(), aligned.T.t.begin(), aligned.T.t.end());
    all.push_back(double(points_.overlap(cloud_.data(), kPoints, kIdentity, 0.5, true).near));
    all.push_back(double(check_.count(cloud_.data(), kPoints, kIdentity, 0.5, 0.5).confirmed));
  }

  void vote(int threads, std::vector<double>& all) const {
    const std::vector<double> places(cloud_.begin(), cloud_.begin() + 600);
    std::vector<std::int64_t> own(200);
    for (std::size_t i = 0; i < own.size(); ++i) own[i] = std::int64_t(i);
    ConsensusOptions options;
    options.inlier_tolerance = 0.6;
    for (const auto& pose : consensus(places.data(), 200, places.data(), own.data(), own.data(),
                                      200, options, threads)) {
      all.insert(all.end(), {pose.yaw, pose.t[0], pose.t[1], pose.t[2]});
    }
    for (const auto& pose : prosac(places.data(), places.data(), own.data(), own.data(), 200, {})) {
      all.insert(all.end(), pose.T.t.begin(), pose.T.t.end());
    }
  }

  const std::vector<float> cloud_ = walls(), vectors_ = random_floats(kRows * kDim, -1, 1, 9),
                           queries_ = random_floats(kQueries * kDim, -1, 1, 10);
  const std::vector<int32_t> roots_ = {0}, feature_ = {0, 0, 0}, child_ = {1, -1, -1};
  const std::vector<float> threshold_ = {0.1f, 0.0f, 1.0f};
  const DescriptorIndex index_{DescriptorRows(vectors_.data(), kRows, kDim), 20, instruction_sets().back(), 2};
  const Forest forest_{{roots_.data(), 1, feature_.data(), threshold_.data(), child_.data(), 3},
                       PairLayout{1, true, 2}.features(kDim)};
  const Surface surface_{cloud_.data(), kPoints, 1.5, 1.6};
  const PointIndex points_{cloud_.data(), kPoints, 0.5};
  const VisibilityCheck check_{cloud_.data(), kPoints, cloud_.data(), 0, 50.0, 1.0, 0.5};
};

void callers() {
  const std::vector<double> expected = Shared().answers(1);
  const Shared shared;  // in which nobody has found a normal yet
  std::vector<std::vector<double>> found(4);
  std::vector<std::thread> others;
  for (std::size_t k = 0; k < found.size(); ++k) {
    others.emplace_back([&, k] { found[k] = shared.answers(1 + int(k) % 3); });
  }
  for (std::thread& other : others) other.join();
  for (const auto& answers : found) CHECK(answers == expected);
}

}  // namespace
}  // namespace segloc

void callers_tests() { segloc::callers(); }
