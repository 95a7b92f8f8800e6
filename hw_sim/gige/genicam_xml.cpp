// The GenICam description, written from the register table.
#include <array>
#include <cstdio>
#include <initializer_list>
#include <map>

#include "hw_sim/gige/register_map.h"

namespace hw_sim {
namespace {

using Kind = Register::Kind;
using Access = Register::Access;

std::string hex(std::uint32_t value) {
  char text[16];
  std::snprintf(text, sizeof text, "0x%X", value);
  return text;
}

// Appended piece by piece: GCC 12 warns falsely of overlap in chains of operator+.
std::string joined(std::initializer_list<std::string_view> pieces) {
  std::string text;
  for (const std::string_view piece : pieces) text += piece;
  return text;
}

std::string element(std::string_view name, std::string_view content) {
  return joined({"<", name, ">", content, "</", name, ">"});
}

std::string open_node(std::string_view kind, std::string_view name) {
  return joined({"<", kind, " Name=\"", name, "\">"});
}

std::string close_node(std::string_view kind) { return joined({"</", kind, ">\n"}); }

std::string_view access_text(Access access) {
  switch (access) {
    case Access::kReadOnly:
      return "RO";
    case Access::kWriteOnly:
      return "WO";
    case Access::kReadWrite:
      break;
  }
  return "RW";
}

struct Cell {  // where a value lies
  std::string_view node_kind;
  std::string name;
  std::uint32_t address = 0;
  std::uint32_t length_bytes = 4;
  std::string_view access = "RW";
  std::string_view port = "Device";
};

std::string register_node(const Cell& cell) {
  std::string node = open_node(cell.node_kind, cell.name) + element("Address", hex(cell.address)) +
                     element("Length", std::to_string(cell.length_bytes)) +
                     element("AccessMode", cell.access) + element("pPort", cell.port) +
                     element("Cachable", "NoCache");
  if (cell.node_kind == "IntReg") node += element("Sign", "Unsigned");
  if (cell.node_kind != "StringReg") node += element("Endianess", "BigEndian");
  return node + close_node(cell.node_kind);
}

std::string_view node_kind(Kind kind) {
  switch (kind) {
    case Kind::kFloat:
      return "Float";
    case Kind::kEnumeration:
      return "Enumeration";
    case Kind::kBoolean:
      return "Boolean";
    case Kind::kCommand:
      return "Command";
    default:
      return "Integer";
  }
}

std::string bounds(const Register& row) {
  std::string text = element("Min", std::to_string(row.min));
  text += row.max_feature.empty() ? element("Max", std::to_string(row.max))
                                  : element("pMax", row.max_feature);
  if (!row.unit.empty()) text += element("Unit", row.unit);
  return text;
}

std::string details(const Register& row) {
  std::string text;
  switch (row.kind) {
    case Kind::kEnumeration:
      for (const auto& [name, value] : row.entries)
        text += open_node("EnumEntry", name) + element("Value", std::to_string(value)) +
                close_node("EnumEntry");
      return text;
    case Kind::kBoolean:
      return element("OnValue", "1") + element("OffValue", "0");
    case Kind::kCommand:
      return element("CommandValue", "1");
    case Kind::kFloat:
    case Kind::kInteger:
      return row.access == Access::kReadWrite ? bounds(row) : text;
    default:
      return text;
  }
}

std::string feature_nodes(const Register& row) {
  if (row.kind == Kind::kText)
    return register_node({.node_kind = "StringReg",
                          .name = std::string(row.name),
                          .address = row.address,
                          .length_bytes = row.length_bytes,
                          .access = access_text(row.access)});
  const Cell cell{.node_kind = row.kind == Kind::kFloat ? "FloatReg" : "IntReg",
                  .name = std::string(row.name) + "Register",
                  .address = row.address,
                  .length_bytes = row.length_bytes,
                  .access = access_text(row.access)};
  const std::string_view kind = node_kind(row.kind);
  std::string node = open_node(kind, row.name) + element("pValue", cell.name) + details(row);
  for (const std::string_view feature : row.selected) node += element("pSelected", feature);
  return node + close_node(kind) + register_node(cell);
}

// GevSCPS: three features share one register, so they are masked (bit 31 is the least significant
// in a big-endian description).
std::string packet_size_nodes() {
  const auto masked = [](std::string_view name, int lsb, int msb) {
    return open_node("MaskedIntReg", name) + element("Address", hex(kStreamPacketSize)) +
           element("Length", "4") + element("AccessMode", "RW") + element("pPort", "Device") +
           element("Cachable", "NoCache") + element("LSB", std::to_string(lsb)) +
           element("MSB", std::to_string(msb)) + element("Sign", "Unsigned") +
           element("Endianess", "BigEndian") + close_node("MaskedIntReg");
  };
  return open_node("Integer", "GevSCPSPacketSize") +
         element("pValue", "GevSCPSPacketSizeRegister") +
         element("Min", std::to_string(kPacketSizeMin)) +
         element("Max", std::to_string(kPacketSizeMax)) + element("Inc", "4") +
         element("Unit", "B") + close_node("Integer") +
         masked("GevSCPSPacketSizeRegister", 31, 16) +
         open_node("Boolean", "GevSCPSDoNotFragment") +
         element("pValue", "GevSCPSDoNotFragmentRegister") + element("OnValue", "1") +
         element("OffValue", "0") + close_node("Boolean") +
         masked("GevSCPSDoNotFragmentRegister", 1, 1) +
         open_node("Boolean", "GevSCPSFireTestPacket") +
         element("pValue", "GevSCPSFireTestPacketRegister") + element("OnValue", "1") +
         element("OffValue", "0") + close_node("Boolean") +
         masked("GevSCPSFireTestPacketRegister", 0, 0);
}

struct ChunkFeature {
  Chunk chunk;
  std::string_view name;
  Kind kind;
};
constexpr std::array<ChunkFeature, kChunkCount - 1> kChunkFeatures{{
    {Chunk::kExposureTime, "ChunkExposureTime", Kind::kFloat},
    {Chunk::kFrameId, "ChunkFrameID", Kind::kInteger},
    {Chunk::kCounterValue, "ChunkCounterValue", Kind::kInteger},
    {Chunk::kSequencerSetActive, "ChunkSequencerSetActive", Kind::kInteger},
    {Chunk::kTimestamp, "ChunkTimestamp", Kind::kInteger},
    {Chunk::kLineStatusAll, "ChunkLineStatusAll", Kind::kInteger},
}};

bool is_selectable(const std::vector<Register>& table, Chunk chunk) {
  for (const Register& row : table) {
    if (row.address != kChunkSelector) continue;
    for (const auto& [name, value] : row.entries)
      if (value == static_cast<std::uint32_t>(chunk)) return true;
  }
  return false;
}

std::string chunk_nodes(const ChunkFeature& feature) {
  const std::string name(feature.name);
  const Cell cell{.node_kind = feature.kind == Kind::kFloat ? "FloatReg" : "IntReg",
                  .name = name + "Register",
                  .address = 0,
                  .length_bytes = kChunkBytes,
                  .access = "RO",
                  .port = feature.name};
  const std::string_view kind = node_kind(feature.kind);
  char id[16];
  std::snprintf(id, sizeof id, "%X", kFirstChunkId + static_cast<std::uint32_t>(feature.chunk));
  const std::string port = name + "Port";
  Cell on_port = cell;
  on_port.port = port;
  return open_node(kind, name) + element("pValue", cell.name) + close_node(kind) +
         register_node(on_port) + open_node("Port", port) + element("ChunkID", id) +
         close_node("Port");
}

std::string category_nodes(const std::map<std::string, std::string>& categories) {
  std::string root = open_node("Category", "Root");
  std::string nodes;
  for (const auto& [name, members] : categories) {
    root += element("pFeature", name);
    nodes += open_node("Category", name) + members + close_node("Category");
  }
  return root + close_node("Category") + nodes;
}

}  // namespace

std::string make_genicam_xml(const std::vector<Register>& table) {
  std::map<std::string, std::string> categories;
  std::string features;
  for (const Register& row : table) {
    if (row.kind == Kind::kHidden) continue;
    features += feature_nodes(row);
    categories[std::string(row.category)] += element("pFeature", row.name);
  }
  features += packet_size_nodes();
  for (const char* name : {"GevSCPSPacketSize", "GevSCPSDoNotFragment", "GevSCPSFireTestPacket"})
    categories["TransportLayerControl"] += element("pFeature", name);
  for (const ChunkFeature& feature : kChunkFeatures) {
    if (!is_selectable(table, feature.chunk)) continue;
    features += chunk_nodes(feature);
    categories["ChunkDataControl"] += element("pFeature", feature.name);
  }
  return "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n"
         "<RegisterDescription ModelName=\"SimulatedCamera\" VendorName=\"ssrig\" "
         "ToolTip=\"Simulated camera of ssrig-sim\" StandardNameSpace=\"GEV\" "
         "SchemaMajorVersion=\"1\" SchemaMinorVersion=\"1\" SchemaSubMinorVersion=\"0\" "
         "MajorVersion=\"1\" MinorVersion=\"0\" SubMinorVersion=\"0\" "
         "ProductGuid=\"6E1C2C57-7C5B-4C09-9F0B-5A1D1F0C7E01\" "
         "VersionGuid=\"6E1C2C57-7C5B-4C09-9F0B-5A1D1F0C7E02\" "
         "xmlns=\"http://www.genicam.org/GenApi/Version_1_1\">\n" +
         category_nodes(categories) + features + open_node("Port", "Device") + close_node("Port") +
         "</RegisterDescription>\n";
}

}  // namespace hw_sim
