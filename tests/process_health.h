// What a process holds on to: for soaks, which ask whether it stays the same.
#pragma once

#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <string>
#include <system_error>
#include <vector>

struct ProcessHealth {
  long resident_kib = 0;
  int descriptor_count = 0;
  int thread_count = 0;
};

inline ProcessHealth health_of(const std::string& process) {  // "self", or a number
  const std::filesystem::path folder = std::filesystem::path("/proc") / process;
  ProcessHealth health;
  std::ifstream status(folder / "status");
  for (std::string line; std::getline(status, line);) {
    if (line.starts_with("VmRSS:")) health.resident_kib = std::stol(line.substr(6));
    if (line.starts_with("Threads:")) health.thread_count = std::stoi(line.substr(8));
  }
  std::error_code gone;
  for (const auto& entry : std::filesystem::directory_iterator(folder / "fd", gone))
    if (!entry.path().empty()) ++health.descriptor_count;
  return health;
}

// Health after each of many equal pieces of work.
class HealthLog {
 public:
  void add(const ProcessHealth& health) { samples_.push_back(health); }

  // Memory settles while caches and pools fill: the last tenth is held against the fifth before the
  // middle. Descriptors and threads may only differ by what comes and goes between two samples.
  bool is_flat() const {
    if (samples_.size() < 10) return true;
    const ProcessHealth early = most(samples_.size() * 3 / 10, samples_.size() / 2);
    const ProcessHealth late = most(samples_.size() * 9 / 10, samples_.size());
    return late.resident_kib <= early.resident_kib + early.resident_kib / 20 + kSlack_kib &&
           late.descriptor_count <= early.descriptor_count + 2 &&
           late.thread_count <= early.thread_count + 1;
  }
  void print() const {
    if (samples_.empty()) return;
    for (const std::size_t tenth : {0U, 1U, 5U, 9U}) {
      const ProcessHealth health = most(samples_.size() * tenth / 10,
                                        std::max<std::size_t>(samples_.size() * (tenth + 1) / 10,
                                                              samples_.size() * tenth / 10 + 1));
      std::printf("tenth %u: at most %.1f MiB, %d descriptors, %d threads\n",
                  static_cast<unsigned>(tenth + 1), static_cast<double>(health.resident_kib) / 1024,
                  health.descriptor_count, health.thread_count);
    }
  }

 private:
  static constexpr long kSlack_kib = 2048;

  ProcessHealth most(std::size_t begin, std::size_t end) const {
    ProcessHealth all;
    for (std::size_t i = begin; i < std::min(end, samples_.size()); ++i) {
      all.resident_kib = std::max(all.resident_kib, samples_[i].resident_kib);
      all.descriptor_count = std::max(all.descriptor_count, samples_[i].descriptor_count);
      all.thread_count = std::max(all.thread_count, samples_[i].thread_count);
    }
    return all;
  }
  std::vector<ProcessHealth> samples_;
};
