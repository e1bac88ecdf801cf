#version 450
// One pixel of what `rendering.py` records: colour, depth and entity in a single picture.
//
// Colours are those of SAPIEN's shader `minimal` for the scenes that `sim.py` builds. What these
// scenes do not have is left out, for a processor without GPU pays for it at every pixel: the
// environment (three look-ups), shadows, point and spot lights, maps of normals and roughness,
// transparency, and a second pass over the whole picture that lays the colour over the background.

layout(constant_id = 0) const int NUM_DIRECTIONAL_LIGHTS = 0;

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

layout(set = 2, binding = 0) uniform MaterialBuffer {
  vec4 emission;
  vec4 baseColor;
  float fresnel;
  float roughness;
  float metallic;
  float transmission;
  float ior;
  float transmissionRoughness;
  int textureMask;
  int padding1;
  vec4 textureTransforms[6];
} material;

layout(set = 2, binding = 1) uniform sampler2D colorTexture;
layout(set = 2, binding = 2) uniform sampler2D roughnessTexture;
layout(set = 2, binding = 3) uniform sampler2D normalTexture;
layout(set = 2, binding = 4) uniform sampler2D metallicTexture;
layout(set = 2, binding = 5) uniform sampler2D emissionTexture;
layout(set = 2, binding = 6) uniform sampler2D transmissionTexture;

struct PointLight {
  vec4 position;
  vec4 emission;
};

struct DirectionalLight {
  vec4 direction;
  vec4 emission;
};

struct SpotLight {
  vec4 position;
  vec4 direction;
  vec4 emission;
};

layout(set = 3, binding = 0) uniform SceneBuffer {
  vec4 ambientLight;
  PointLight pointLights[10];
  DirectionalLight directionalLights[3];
  SpotLight spotLights[10];
  SpotLight texturedLights[1];
} scene;

layout(location = 0) in vec3 inPosition;
layout(location = 1) in vec3 inNormal;
layout(location = 2) in vec2 inUV;

layout(location = 0) out ivec4 outSeen;

const float PI = 3.141592653589793;
const float LEAST = 1e-6;
const int HAS_COLOR_TEXTURE = 1;

// Share of a light that a surface sends to the eye: Lambert, and GGX for the gloss.
// Source: B. Karis, Real Shading in Unreal Engine 4, SIGGRAPH 2013, equations 1 to 5.
vec3 reflected(vec3 n, vec3 v, vec3 l, vec3 albedo, vec3 gloss, float roughness) {
  vec3 between = l + v;
  vec3 h = dot(between, between) < LEAST ? vec3(0) : normalize(between);
  float n_l = clamp(dot(n, l), 0, 1);
  float n_v = clamp(dot(n, v), LEAST, 1);
  float n_h = clamp(dot(n, h), LEAST, 1);
  float v_h = clamp(dot(v, h), LEAST, 1);
  float alpha = roughness * roughness;
  float alpha2 = alpha * alpha;
  float k = (roughness + 1) * (roughness + 1) / 8;
  float spread = n_h * n_h * (alpha2 - 1) + 1;
  float unshadowed = (n_v * (1 - k) + k) * (n_l * (1 - k) + k);
  vec3 fresnel = gloss + (1 - gloss) * exp2((-5.55473 * v_h - 6.98316) * v_h);
  float parts = clamp(4 * PI * spread * spread * unshadowed, LEAST, 4 * PI);
  return n_l * (albedo / PI + fresnel * alpha2 / parts);
}

void main() {
  vec3 color = material.baseColor.rgb;
  if ((material.textureMask & HAS_COLOR_TEXTURE) != 0) {
    color = texture(colorTexture, inUV).rgb;
  }
  vec3 albedo = color * (1 - material.metallic);
  vec3 gloss = mix(vec3(material.fresnel * 0.08), color, material.metallic);
  vec3 n = normalize(inNormal);
  vec3 v = -normalize(inPosition);

  vec3 light = material.emission.rgb + scene.ambientLight.rgb * color;
  for (int i = 0; i < NUM_DIRECTIONAL_LIGHTS; ++i) {
    vec3 l = -(mat3(camera.viewMatrix) * scene.directionalLights[i].direction.xyz);
    light += scene.directionalLights[i].emission.rgb
        * reflected(n, v, l, albedo, gloss, material.roughness);
  }

  vec3 shown = clamp(pow(light, vec3(1 / 2.2)), 0, 1);
  ivec3 rgb = ivec3(shown * 255 + 0.5);
  int depth_mm = int(-inPosition.z * 1000);
  int entity = int(numbers.segmentation[1]);
  // Four bytes for the colour, then two numbers of two bytes; as signed ones, which is what the
  // picture's format takes.
  ivec4 words = ivec4(rgb.r | rgb.g << 8, rgb.b | 255 << 8, depth_mm, entity);
  outSeen = words << 16 >> 16;
}
