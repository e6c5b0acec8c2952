// UseClient URL FILE PORT: upload, wait, receive the webhook and download through the client that openapi-generator makes.
using System;
using System.Collections.Generic;
using System.IO;
using System.Linq;
using System.Net;
using System.Security.Cryptography;
using System.Text;
using System.Threading.Tasks;
using DynamicTree.Api;
using DynamicTree.Client;
using DynamicTree.Model;
using Newtonsoft.Json;

namespace JsonSubTypes { }  // the generated code names it in one `using`, and uses nothing of it

public static class UseClient
{
    public static async Task Main(string[] arguments)
    {
        string url = arguments[0], file = arguments[1], hook = $"http://127.0.0.1:{arguments[2]}/";
        using var listener = new HttpListener();
        listener.Prefixes.Add(hook);
        listener.Start();
        var webhooks = new WebhooksApi(url);
        var endpoint = webhooks.CreateWebhookEndpoint(new EndpointRequest(hook));

        var uploads = new UploadsApi(url);
        string name = Convert.ToBase64String(Encoding.UTF8.GetBytes(Path.GetFileName(file)));
        var begun = uploads.CreateUploadWithHttpInfo("1.0.0", new FileInfo(file).Length.ToString(), "filename " + name);
        string uploadId = begun.Headers["Location"].Single().Split('/').Last();
        const string offset = "application/offset+octet-stream";
        using (var content = File.OpenRead(file))
            uploads.AppendToUpload(uploadId, "1.0.0", "0", offset, new FileParameter("tree", offset, content));
        var asset = new AssetsApi(url).CreateAsset(new AssetRequest(uploadIds: new List<string> { uploadId }));

        var jobs = new JobsApi(url);
        var formats = new List<AnimateParams.FormatsEnum> { AnimateParams.FormatsEnum.Glb };
        var request = new Body(new AnimateRequest(
            assetId: asset.Id, seed: 11, type: AnimateRequest.TypeEnum.Animate, varParams: new AnimateParams(numSteps: 1, formats: formats)));
        var job = jobs.CreateJob(request, "csharp");
        if (jobs.CreateJob(request, "csharp").Id != job.Id) throw new Exception("one key, two jobs");
        while (job.State is JobState.Queued or JobState.Running) job = jobs.GetJob(job.Id, prefer: "wait=20");
        if (job.State != JobState.Succeeded) throw new Exception(job.ToJson());

        var seen = await Received(listener, endpoint.Secret);
        webhooks.DeleteWebhookEndpoint(endpoint.Id);
        Console.WriteLine($"event {seen.Type} {seen.Data.Id == job.Id}");

        var artifact = jobs.ListArtifacts(job.Id).Artifacts.Single(each => each.Name.EndsWith(".glb"));
        using var bytes = new MemoryStream();
        new ArtifactsApi(url).GetArtifact(artifact.Id).Content.CopyTo(bytes);
        string hash = Convert.ToHexString(SHA256.HashData(bytes.ToArray())).ToLowerInvariant();
        Console.WriteLine($"file {artifact.Name} {hash == artifact.Sha256}");

        try { jobs.GetJob("00000000000000000000000000"); }
        catch (ApiException refused) { Console.WriteLine($"refused {refused.ErrorCode}"); }
    }

    private static async Task<JobEventPayload> Received(HttpListener listener, string secret)
    {
        var context = await listener.GetContextAsync().WaitAsync(TimeSpan.FromSeconds(60));
        string text = await new StreamReader(context.Request.InputStream, Encoding.UTF8).ReadToEndAsync();
        context.Response.StatusCode = 204;
        context.Response.Close();
        string signed = $"{context.Request.Headers["webhook-id"]}.{context.Request.Headers["webhook-timestamp"]}.{text}";
        byte[] key = Convert.FromBase64String(secret.Substring("whsec_".Length));
        string wanted = "v1," + Convert.ToBase64String(HMACSHA256.HashData(key, Encoding.UTF8.GetBytes(signed)));
        if (!context.Request.Headers["webhook-signature"].Split(' ').Contains(wanted)) throw new Exception("signature");
        return JsonConvert.DeserializeObject<JobEventPayload>(text);
    }
}
