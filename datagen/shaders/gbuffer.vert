#version 450
// Vertices of what `rendering.py` records; `gbuffer.frag` says what becomes of them.
// Files, blocks and their members are named as SAPIEN wants them.

layout(set = 0, binding = 0) uniform CameraBuffer {
  mat4 viewMatrix;
  mat4 projectionMatrix;
  mat4 viewMatrixInverse;
  mat4 projectionMatrixInverse;
  float width;
  float height;
} camera;

layout(set = 1, binding = 0) uniform ObjectTransformBuffer {
  mat4 modelMatrix;
} body;

layout(set = 1, binding = 1) uniform ObjectDataBuffer {
  uvec4 segmentation;
  float transparency;
  int shadeFlat;
} numbers;

// All five, used or not: SAPIEN lays meshes out in one way for all shaders of a process.
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
layout(location = 2) in vec2 uv;
layout(location = 3) in vec3 tangent;
layout(location = 4) in vec3 bitangent;

layout(location = 0) out vec3 outPosition;
layout(location = 1) out vec3 outNormal;
layout(location = 2) out vec2 outUV;

void main() {
  mat4 T_view_body = camera.viewMatrix * body.modelMatrix;
  vec4 seen = T_view_body * vec4(position, 1);
  gl_Position = camera.projectionMatrix * seen;
  outPosition = seen.xyz;
  // Right for what is turned and moved, and for boxes, which SAPIEN scales along their axes.
  outNormal = mat3(T_view_body) * normal;
  outUV = uv;
}
