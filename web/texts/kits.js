// What each program is given of a mesh and of a cloud, and its README: ten lines, in English as the programs' own words.

const readme = (title, lines) => (name) => [`${name}: ${title}`, "", ...lines, ""].join("\n");

export default {
  blender: {
    mesh: ["glb"],
    cloud: ["splat-ply"],
    readme: readme("for Blender 4 and 5", [
      "1. Set the frame rate to 24 (Output properties, Frame Rate): the loop then has whole frames.",
      "2. File > Import > glTF 2.0, choose tree.glb.",
      "3. Press Space. The tree sways: bones move it, one for each twig and leaf.",
      "4. To repeat it: Graph Editor, select all curves, Shift E, Make Cyclic.",
      "5. Render with Eevee or Cycles as it is; materials and textures are those of your file.",
      "Of a splat: splat.ply.zip has one PLY a frame, for an add-on that reads splats.",
    ]),
  },
  unity: {
    mesh: ["glb", "wind"],
    readme: readme("for Unity 2022 and later", [
      "1. Window > Package Manager > + > Add by name: com.unity.cloud.gltfast",
      "2. Put tree.glb into Assets, drag it into the scene.",
      "3. Select the clip 'sway', tick Loop Time, and give it to an Animator.",
      "4. Press Play: joints move the tree, four a vertex, at the cost of any character.",
      "For wind that never repeats and bends with its speed: tree.wind.zip.",
      "Its own README says which texture goes where; the HLSL for a vertex stage lies beside it.",
    ]),
  },
  unreal: {
    mesh: ["glb", "wind"],
    readme: readme("for Unreal 5", [
      "1. Import tree.glb (Interchange) as a skeletal mesh with its animation.",
      "2. Drag the animation sequence into the level, tick Looping.",
      "3. Press Play.",
      "For foliage and wind that never repeats: tree.wind.zip.",
      "Import its mesh as a static mesh with Use Full Precision UVs, its textures as HDR without mips and without sRGB.",
      "The HLSL for World Position Offset lies beside them.",
    ]),
  },
  godot: {
    mesh: ["glb", "wind"],
    readme: readme("for Godot 4", [
      "1. Copy tree.glb into the project; it imports by itself.",
      "2. Double-click it, choose the animation 'sway', set Loop Mode to Linear, Reimport.",
      "3. Drag it into a scene and press Play in its AnimationPlayer.",
      "For wind that never repeats and bends with its speed: unpack tree.wind.zip into the project.",
      "Give its script to the node of its mesh; the two shaders that it uses lie beside it.",
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
      "Of a splat, tree-splat.usdz has a Gaussian splat with a time sample a frame.",
      "preview.mp4 shows how it should look.",
      "Units are metres; 24 frames a second; the loop closes: after the last frame comes the first.",
    ]),
  },
};
