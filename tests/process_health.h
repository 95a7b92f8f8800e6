// What a process holds on to: for soaks, which ask whether it stays the same.
#pragma once

#include <malloc.h>

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

// What this process holds on to, without what its allocator keeps of what was given back.
inline ProcessHealth own_health() {
  ::malloc_trim(0);
  return health_of("self");
}

// Health after each of many equal pieces of work.
class HealthLog {
 public:
  void add(const ProcessHealth& health) { samples_.push_back(health); }

  // Memory settles while caches and pools fill, and steps by what the allocator keeps or gives back
  // (a set of pictures is 69 MB): the most of the last quarter is held against the most of the
  // third.
  bool is_flat() const {
    if (samples_.size() < 8) return true;
    const ProcessHealth before = most_of_quarter(2);
    const ProcessHealth last = most_of_quarter(3);
    return last.resident_kib <= before.resident_kib + before.resident_kib / 20 + kSlack_kib &&
           last.descriptor_count <= before.descriptor_count + 2 &&
           last.thread_count <= before.thread_count + 1;
  }
  void print() const {
    for (std::size_t quarter = 0; quarter < 4; ++quarter) {
      const ProcessHealth health = most_of_quarter(quarter);
      std::printf("quarter %d: at most %.1f MiB, %d descriptors, %d threads\n",
                  static_cast<int>(quarter + 1), static_cast<double>(health.resident_kib) / 1024,
                  health.descriptor_count, health.thread_count);
    }
  }

 private:
  static constexpr long kSlack_kib = 2048;

  ProcessHealth most_of_quarter(std::size_t quarter) const {
    ProcessHealth all;
    for (std::size_t i = samples_.size() * quarter / 4; i < samples_.size() * (quarter + 1) / 4;
         ++i) {
      all.resident_kib = std::max(all.resident_kib, samples_[i].resident_kib);
      all.descriptor_count = std::max(all.descriptor_count, samples_[i].descriptor_count);
      all.thread_count = std::max(all.thread_count, samples_[i].thread_count);
    }
    return all;
  }
  std::vector<ProcessHealth> samples_;
};
