// What each program is given of a mesh and of a cloud, and its README: ten lines, in English as the programs' own words.
// The splat of Blender's kit is one frame, which the mesh of the kit carries there: all frames are 100 times as much.

const readme = (title, lines) => (name) => [`${name}: ${title}`, "", ...lines, ""].join("\n");

export default {
  blender: {
    mesh: ["glb"],
    cloud: ["glb", "splat-ply"],
    params: { cloud: { wind_mode: "loop", num_frames: 1, loop: false } },
    readme: readme("for Blender 4 and 5", [
      "1. Set the frame rate to 24 (Output properties, Frame Rate): the loop then has whole frames.",
      "2. File > Import > glTF 2.0, choose tree.glb.",
      "3. Timeline: Start 0, End one before the last key, which repeats the first. Space: the tree sways.",
      "4. To repeat it: skeleton, Pose Mode, A; then in the Graph Editor A, Shift E, Make Cyclic.",
      "5. Render with Eevee or Cycles as it is; materials and textures are those of your file.",
      "Of a splat, tree.glb is the surface that carries it, and frame_0000.ply in splat.ply.zip the splat in frame 0. With",
      "KIRI's 3DGS Render 5: import it, turn and scale it onto the mesh, Proxy Mesh: the mesh, Bind to Proxy Mesh, bake.",
    ]),
  },
  unity: {
    mesh: ["glb", "wind"],
    readme: readme("for Unity 2022 and later", [
      "1. Window > Package Manager > + > Add by name: com.unity.cloud.gltfast",
      "2. Put tree.glb into Assets, drag it into the scene.",
      "3. Drag the clip 'sway' inside tree.glb onto it: it gets an Animator. The clip loops as imported.",
      "4. Press Play: joints move the tree, four a vertex, at the cost of any character.",
      "For wind that never repeats and bends with its speed: tree.wind.zip. Begin with the first lines of",
      "wind-unity.shader, which computes the bones from bones.exr, and wind-unity.hlsl, which moves tree-bones.glb.",
    ]),
  },
  unreal: {
    mesh: ["glb", "wind"],
    readme: readme("for Unreal 5", [
      "1. Import tree.glb (Interchange) as a skeletal mesh with its animation.",
      "2. Drag the animation sequence into the level, tick Looping.",
      "3. Press Play.",
      "For foliage and wind that never repeats: tree.wind.zip. Import tree-bones.glb as a static mesh with Use Full",
      "Precision UVs, bones.exr as HDR (RGBA16F), Nearest, no mips, no sRGB. Begin with the first lines of",
      "wind-unreal-poses.hlsl, which computes the bones, and wind-unreal.hlsl, for World Position Offset.",
    ]),
  },
  godot: {
    mesh: ["glb", "wind"],
    readme: readme("for Godot 4", [
      "1. Copy tree.glb into the project; it imports by itself.",
      "2. Double-click it, choose the animation 'sway', set Loop Mode to Linear, Reimport.",
      "3. Drag it into a scene and press Play in its AnimationPlayer.",
      "For wind that never repeats and bends with its speed: unpack tree.wind.zip into the project.",
      "Begin with the first lines of wind-godot.gd, the script of a SubViewport that draws wind-godot-poses.gdshader,",
      "and of wind-godot.gdshader, for the materials of tree-bones.glb.",
    ]),
  },
  web: {
    mesh: [],
    cloud: [],
    readme: readme("for the web", [
      "1. Copy this folder to any web server: no program runs there, files are enough.",
      "2. Open its address. The tree sways, and a branch can be pulled.",
      "To try it here: python3 -m http.server, then http://localhost:8000",
      "In a page of yours: <iframe src='this-folder/'></iframe>",
      "After a # in the address: turntable=1, theme=light or theme=dark, transparent=1.",
      "tree/ is the tree, web/ the viewer and its libraries with their licences.",
    ]),
  },
  film: {
    mesh: ["alembic", "usd", "mp4"],
    cloud: ["usd-splat", "mp4"],
    readme: readme("for film and effects", [
      "tree.abc (Alembic): every vertex in every frame. Houdini: Alembic SOP. Maya: Cache > Alembic Cache > Import.",
      "tree.usdz (USD): the same with materials and textures. Houdini Solaris: Sublayer LOP. Omniverse, usdview: open it.",
      "Of a splat, tree-splat.usdz has a Gaussian splat with a time sample a frame. preview.mp4 shows how it looks.",
      "Metres, +Y up in tree.abc, +Z up in USD; 24 frames a second; after the last frame of a loop comes the first.",
    ]),
  },
};
