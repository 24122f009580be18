// Float memory that starts on a cache line, so that no vector load straddles two.
#pragma once

#include <algorithm>
#include <cstddef>
#include <memory>
#include <new>

namespace segloc {

class AlignedFloats {
 public:
  explicit AlignedFloats(std::size_t size = 0) : size_(size) {
    if (size == 0) return;
    data_.reset(static_cast<float*>(::operator new(size * sizeof(float), kAlignment)));
    std::fill(data_.get(), data_.get() + size, 0.0f);
  }
  float* data() { return data_.get(); }
  const float* data() const { return data_.get(); }
  std::size_t size() const { return size_; }
  float& operator[](std::size_t i) { return data_.get()[i]; }
  float operator[](std::size_t i) const { return data_.get()[i]; }

 private:
  static constexpr std::align_val_t kAlignment{64};
  struct Release {
    void operator()(float* p) const { ::operator delete(p, kAlignment); }
  };
  std::unique_ptr<float, Release> data_;
  std::size_t size_;
};

}  // namespace segloc
