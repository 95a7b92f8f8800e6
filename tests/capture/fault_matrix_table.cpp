// Prints the fault matrix, or with a file's name writes it there, between the marks.
#include <cstdio>
#include <fstream>
#include <iterator>
#include <string>

#include "tests/capture/fault_matrix.h"

int main(int argc, char** argv) {
  const std::string table = capture::fault_matrix_table(capture::run_fault_matrix());
  if (argc < 2) {
    std::fputs(table.c_str(), stdout);
    return 0;
  }
  std::ifstream in(argv[1]);
  const std::string readme{std::istreambuf_iterator<char>(in), {}};
  std::ofstream(argv[1]) << capture::with_fault_matrix(readme, table);
  return 0;
}
