// Blocks of a range, handed out to threads of this call. torch's own OpenMP pool is not shared: a second copy of
// the OpenMP library in one process would start a pool of its own beside it.
#pragma once
#include <algorithm>
#include <atomic>
#include <cstdint>
#include <thread>
#include <vector>

// make() is called once per thread and returns work(start, size), which is called block by block.
template <class Make> void in_blocks(int64_t count, int64_t block, int threads, Make make) {
  std::atomic<int64_t> next{0};
  auto run = [&] {
    auto work = make();
    for (int64_t start; (start = next.fetch_add(block)) < count;) work(start, (int)std::min(block, count - start));
  };
  std::vector<std::thread> crew;
  for (int64_t i = 1; i < std::min<int64_t>(threads, (count + block - 1) / block); ++i) crew.emplace_back(run);
  run();
  for (auto &thread : crew) thread.join();
}
