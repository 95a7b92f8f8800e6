#include "rig/devices/picture_book.h"

#include <epoxy/gl.h>

#include <array>
#include <string>

#include "rig/devices/projector_monitor.h"

namespace rig {
namespace {

SquarePlace place_square(const ProjectorSettings& settings) {
  const SyncSquareSettings& square = settings.sync_square;
  const bool is_right = square.corner == Corner::kTopRight || square.corner == Corner::kBottomRight;
  const bool is_bottom =
      square.corner == Corner::kBottomLeft || square.corner == Corner::kBottomRight;
  const int left_px = is_right ? settings.width_px - square.size_px : 0;
  const int top_px = is_bottom ? settings.height_px - square.size_px : 0;
  return {left_px, top_px, left_px + square.size_px, top_px + square.size_px};
}

constexpr const char* kVertexShader = R"(#version 330 core
void main() {  // one triangle over the whole window
  vec2 corner = vec2((gl_VertexID << 1) & 2, gl_VertexID & 2);
  gl_Position = vec4(corner * 2.0 - 1.0, 0.0, 1.0);
})";

// Integers until the last line, so that the bytes on the screen are those of the picture.
constexpr const char* kFragmentShader = R"(#version 330 core
uniform usampler2DArray pictures;
uniform int layer;          // -1: black
uniform ivec4 square;       // left, top, right, bottom
uniform uint square_level;  // 0..255
uniform int height_px;
out vec4 color;
void main() {
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  pixel.y = height_px - 1 - pixel.y;  // picture row 0 is at the top
  uint level = layer < 0 ? 0u : texelFetch(pictures, ivec3(pixel, layer), 0).r;
  if (all(greaterThanEqual(pixel, square.xy)) && all(lessThan(pixel, square.zw)))
    level = square_level;
  color = vec4(vec3(float(level) / 255.0), 1.0);
})";

Result<GLuint> compile(GLenum kind, const char* source) {
  const GLuint shader = glCreateShader(kind);
  glShaderSource(shader, 1, &source, nullptr);
  glCompileShader(shader);
  GLint is_compiled = GL_FALSE;
  glGetShaderiv(shader, GL_COMPILE_STATUS, &is_compiled);
  if (is_compiled == GL_TRUE) return shader;
  std::array<char, 1024> log{};
  glGetShaderInfoLog(shader, static_cast<GLsizei>(log.size()), nullptr, log.data());
  return failure(Fault::kUnsupported,
                 "the graphics driver refuses our shader: " + std::string(log.data()));
}

}  // namespace

Result<PictureBook> PictureBook::create(const ProjectorSettings& settings) {
  const Result<GLuint> vertex = compile(GL_VERTEX_SHADER, kVertexShader);
  if (!vertex) return tl::unexpected(vertex.error());
  const Result<GLuint> fragment = compile(GL_FRAGMENT_SHADER, kFragmentShader);
  if (!fragment) return tl::unexpected(fragment.error());
  return PictureBook(settings, *vertex, *fragment);
}

PictureBook::PictureBook(const ProjectorSettings& settings, unsigned vertex_shader,
                         unsigned fragment_shader)
    : width_px_(settings.width_px),
      height_px_(settings.height_px),
      is_inverted_(settings.sync_square.is_inverted),
      square_(place_square(settings)) {
  const GLuint program = glCreateProgram();
  glAttachShader(program, vertex_shader);
  glAttachShader(program, fragment_shader);
  glLinkProgram(program);
  glUseProgram(program);
  square_uniform_ = glGetUniformLocation(program, "square");
  square_level_uniform_ = glGetUniformLocation(program, "square_level");
  layer_uniform_ = glGetUniformLocation(program, "layer");
  glUniform1i(glGetUniformLocation(program, "height_px"), height_px_);

  GLuint vertices = 0;
  glGenVertexArrays(1, &vertices);  // a core profile draws nothing without one
  glBindVertexArray(vertices);
  GLuint texture = 0;
  glGenTextures(1, &texture);
  glBindTexture(GL_TEXTURE_2D_ARRAY, texture);
  glTexParameteri(GL_TEXTURE_2D_ARRAY, GL_TEXTURE_MIN_FILTER, GL_NEAREST);
  glTexParameteri(GL_TEXTURE_2D_ARRAY, GL_TEXTURE_MAG_FILTER, GL_NEAREST);
  glPixelStorei(GL_UNPACK_ALIGNMENT, 1);
  glDisable(GL_DITHER);
  glDisable(GL_FRAMEBUFFER_SRGB);
  glViewport(0, 0, width_px_, height_px_);
  glGetIntegerv(GL_MAX_ARRAY_TEXTURE_LAYERS, &limit_);
}

Result<void> PictureBook::upload(const std::vector<estimation::Image<unsigned char>>& pictures) {
  const auto count = static_cast<GLsizei>(pictures.size());
  if (count == 0) return {};
  while (glGetError() != GL_NO_ERROR) continue;  // older errors are not this upload's
  glTexImage3D(GL_TEXTURE_2D_ARRAY, 0, GL_R8UI, width_px_, height_px_, count, 0, GL_RED_INTEGER,
               GL_UNSIGNED_BYTE, nullptr);
  for (GLsizei i = 0; i < count; ++i)
    glTexSubImage3D(GL_TEXTURE_2D_ARRAY, 0, 0, 0, i, width_px_, height_px_, 1, GL_RED_INTEGER,
                    GL_UNSIGNED_BYTE, pictures[static_cast<std::size_t>(i)].samples().data());
  glFinish();
  if (glGetError() == GL_NO_ERROR) return {};
  return failure(Fault::kOutOfRange, "the graphics card has no room for " + std::to_string(count) +
                                         " pictures of " + size_text(width_px_, height_px_) +
                                         " px");
}

void PictureBook::draw(const ShowRequest& request) {
  const bool is_white = request.is_square_light != is_inverted_;
  glUniform4i(square_uniform_, square_.left_px, square_.top_px, square_.right_px,
              square_.bottom_px);
  glUniform1ui(square_level_uniform_, is_white ? 255U : 0U);
  draw_layer(request.picture);
}

void PictureBook::draw_black() {
  glUniform4i(square_uniform_, 0, 0, 0, 0);
  draw_layer(kBlackPicture);
}

void PictureBook::draw_layer(int layer) {
  glUniform1i(layer_uniform_, layer);
  glDrawArrays(GL_TRIANGLES, 0, 3);
}

}  // namespace rig
